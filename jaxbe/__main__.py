"""`python -m jaxbe`: the command line."""

import sys

from jaxbe.cli import main

if __name__ == "__main__":
    sys.exit(main())
