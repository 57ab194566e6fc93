"""Array types with their shapes, for signatures.

The shapes are read by type checkers and people; at run time every name is a
plain `jax.Array`, so that the core depends on jax and numpy alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Bool, Float

    Flags = Bool[Array, "*batch"]
    """Booleans of any batch shape."""
    Scalars = Float[Array, "*batch"]
    """Numbers of any batch shape."""
    Vectors = Float[Array, "*batch 3"]
    """Vectors (..., 3)."""
    Quaternions = Float[Array, "*batch 4"]
    """Quaternions (..., 4), scalar part first."""
    Matrices = Float[Array, "*batch 3 3"]
    """Matrices (..., 3, 3)."""
else:
    from jax import Array

    Flags = Scalars = Vectors = Quaternions = Matrices = Array

Components = tuple[Scalars, Scalars, Scalars]
"""A vector as three arrays, one a component: what the kernels compute with."""

ComponentMatrix = tuple[Components, Components, Components]
"""A 3x3 matrix as three rows of component arrays."""

ArrayLike = Any
"""What a constructor takes: an array, or nested lists of Python numbers."""
