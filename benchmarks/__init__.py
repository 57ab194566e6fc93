"""Measurements of jaxbe. Run them from the repository root."""
