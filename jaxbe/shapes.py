"""The two bodies: an oriented box and an oriented ellipsoid, solid and closed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Self

import jax
import jax.numpy as jnp

from jaxbe import validate
from jaxbe.types import ArrayLike, Matrices, Quaternions, Vectors


@dataclasses.dataclass(frozen=True, eq=False)
class _Body:
    """What both bodies share: construction, checks and being a pytree.

    JAX rebuilds pytrees from gradients, axis numbers and sentinels too, so
    values are checked by the constructor and never on unflattening.
    """

    def __post_init__(self) -> None:
        kind, narrow = type(self).__name__, validate.narrow_axes(self.fields())
        self._set(validate.as_floats(kind, self.fields()))
        self.check_form()
        validate.check_values(kind, {**self.fields(), **narrow})

    def __init_subclass__(cls) -> None:
        jax.tree_util.register_pytree_with_keys(
            cls, cls._flatten_with_keys, cls._unflatten
        )

    @classmethod
    def from_quaternion(
        cls, center: ArrayLike, wxyz: ArrayLike, lengths: ArrayLike
    ) -> Self:
        """Builds the body from a rotation given as a quaternion.

        Args:
            center: (..., 3), metres, world frame.
            wxyz: (..., 4), scalar part first, of any length but zero (or denormal).
            lengths: (..., 3), metres: half extents of a box, semi-axes of an
                ellipsoid.

        Raises:
            TypeError: wrong or mixed dtypes.
            ValueError: as the constructor, or a quaternion of length zero.
        """
        given = {"center": center, "wxyz": wxyz, cls._names()[2]: lengths}
        fields = validate.as_floats(cls.__name__, given)
        validate.check_fields(cls.__name__, fields)
        validate.check_values(cls.__name__, fields)
        center, wxyz, lengths = fields.values()
        return cls._unflatten(None, (center, rotation_matrix(wxyz), lengths))

    @classmethod
    def unchecked(cls, *fields: ArrayLike) -> Self:
        """Builds the body without reading values: for poses that may be NaN.

        Shapes and dtypes are checked as ever.

        Args:
            *fields: as in the constructor, in its order.

        Raises:
            TypeError: wrong or mixed dtypes.
            ValueError: wrong shapes.
        """
        return cls._converted(validate.as_floats, fields)

    @classmethod
    def on_host(cls, *fields: ArrayLike) -> Self:
        """Builds the body of NumPy arrays that stay where they are, also on disk.

        For `jaxbe.chunked`: batches that no device has room for. Nothing is copied, and
        values are not read; shapes and dtypes are checked as ever.

        Args:
            *fields: as in the constructor, in its order: arrays of NumPy, memory-mapped
                ones too; float32 or float64, not bfloat16, which would have to be
                converted. An array of JAX is fetched from its device.

        Raises:
            TypeError: wrong or mixed dtypes.
            ValueError: wrong shapes.
        """
        return cls._converted(validate.as_host_floats, fields)

    @classmethod
    def _converted(
        cls, convert: Callable[..., dict[str, Any]], fields: tuple[ArrayLike, ...]
    ) -> Self:
        """Built of fields whose values nobody reads."""
        named = dict(zip(cls._names(), fields, strict=True))
        body = cls._unflatten(None, fields)
        body._set(convert(cls.__name__, named))
        body.check_form()
        return body

    def fields(self) -> dict[str, Any]:
        """The three arrays by name."""
        return {name: getattr(self, name) for name in self._names()}

    def check_form(self) -> tuple[int, ...]:
        """Checks shapes and dtypes (at trace time); returns the batch shape.

        Raises:
            TypeError: wrong or mixed dtypes.
            ValueError: wrong shapes.
        """
        return validate.check_fields(type(self).__name__, self.fields())

    @classmethod
    def _names(cls) -> tuple[str, ...]:
        return tuple(f.name for f in dataclasses.fields(cls))

    def _set(self, arrays: dict[str, Any]) -> None:
        for name, x in arrays.items():
            object.__setattr__(self, name, x)

    def _flatten_with_keys(self) -> tuple[list[tuple[Any, Any]], None]:
        keyed = [(jax.tree_util.GetAttrKey(n), x) for n, x in self.fields().items()]
        return keyed, None

    @classmethod
    def _unflatten(cls, _: None, leaves: Any) -> Self:
        body = object.__new__(cls)
        body._set(dict(zip(cls._names(), leaves, strict=True)))
        return body


@dataclasses.dataclass(frozen=True, eq=False)
class Box(_Body):
    """A solid box: the points center + axes @ x with |x_i| <= half_extents_i.

    Leading axes are batch axes and broadcast. A frozen pytree: it passes
    through `jit`, `vmap` and `grad`. Arrays of bfloat16 become float32 ones, exactly,
    and so is every answer; their axes, which eight bits leave orthonormal to 1 %,
    become the nearest orthonormal ones. Arrays of NumPy are copied.

    Not itself a thing to optimise: a step in the entries of `axes` leaves the
    rotations. Optimise a position and a quaternion, and build the body of them by
    `from_quaternion` inside the function that is differentiated.

    Args:
        center: (..., 3), metres, world frame.
        axes: (..., 3, 3), the unit axes in its *columns*, world frame. Mirrored
            axes are legal: a box equals its mirror image.
        half_extents: (..., 3), metres, half the edge lengths. Zero is legal: a
            plate, a rod, a point.

    Raises:
        TypeError: a field that is not float32, float64 or bfloat16, or fields of
            float32 and float64.
        ValueError: wrong shapes; and, for concrete arrays, values that are not
            finite, negative half extents, or axes further from orthonormal than
            1000 units of rounding.
    """

    center: Vectors
    axes: Matrices
    half_extents: Vectors


@dataclasses.dataclass(frozen=True, eq=False)
class Ellipsoid(_Body):
    """A solid ellipsoid: the points center + axes @ y, sum (y_i / semi_axes_i)^2 <= 1.

    Leading axes are batch axes and broadcast. A frozen pytree: it passes
    through `jit`, `vmap` and `grad`. Arrays of bfloat16 become float32 ones, exactly,
    and so is every answer; their axes, which eight bits leave orthonormal to 1 %,
    become the nearest orthonormal ones. Arrays of NumPy are copied.

    Not itself a thing to optimise: a step in the entries of `axes` leaves the
    rotations, and semi-axes become negative. Optimise a position and a quaternion (of
    lengths, the logarithm), and build the body of them by `from_quaternion` inside the
    function that is differentiated.

    Args:
        center: (..., 3), metres, world frame.
        axes: (..., 3, 3), the unit axes in its *columns*, world frame.
        semi_axes: (..., 3), metres, positive; a denormal number counts as zero.

    Raises:
        TypeError: a field that is not float32, float64 or bfloat16, or fields of
            float32 and float64.
        ValueError: wrong shapes; and, for concrete arrays, values that are not
            finite, semi-axes that are not positive, or axes further from
            orthonormal than 1000 units of rounding.
    """

    center: Vectors
    axes: Matrices
    semi_axes: Vectors


def rotation_matrix(wxyz: Quaternions) -> Matrices:
    """The rotation matrix of a quaternion of any length but zero.

    Args:
        wxyz: (..., 4), scalar part first.

    Returns:
        (..., 3, 3), orthonormal to a few units of rounding; NaN for the zero
        quaternion.
    """
    size = jax.lax.stop_gradient(jnp.max(abs(wxyz), axis=-1, keepdims=True))
    w, x, y, z = (wxyz[..., i] / size[..., 0] for i in range(4))
    s = 2 / (w * w + x * x + y * y + z * z)
    rows = (
        (1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        (s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
        (s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
    )
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
