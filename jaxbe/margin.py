"""`margin`: by how much do they touch? A smooth signed quantity, and its bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbe import _xla
from jaxbe.growth import MAX_STEPS, growth_bounds, growth_distance
from jaxbe.pose import canonical_pair, runtime_witness
from jaxbe.shapes import Box, Ellipsoid
from jaxbe.types import Scalars
from jaxbe.validate import DTYPES, as_count, as_number

DEFAULT_STEPS = 5

ARITHMETIC_ROUNDINGS = 97
"""In `rounding_slack`, what arithmetic adds, in units of eps times the aspect ratio."""

AXES_ROUNDINGS = 3.75
"""And what each eps adds by which the axes differ from orthonormal."""


def margin(box: Box, ellipsoid: Ellipsoid, *, steps: int = DEFAULT_STEPS) -> Scalars:
    """The growth distance minus one: the factor by which both must grow to touch.

    Negative when they overlap, zero at touching, positive apart; -1 at coincident
    centres. Both bodies are scaled about their own centres. Continuously
    differentiable in every parameter but at coincident centres, and informative at
    any depth.

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        steps: evaluations of the kernel, from 0 to 10: accuracy for time. Every count
            gives a lower bound that grows with the count, so that stopping early can
            call a separated pair overlapping and never the reverse; 0 is the slab
            box B' of the paper's section 5.

    Returns:
        Dimensionless, of the common batch shape. NaN if any number is NaN or
        infinite, and in float32 where the centres are further apart than some 1e18 of
        the smallest semi-axis. Zero half extents are legal.

        Accuracy at 5 steps, relative to max(1, growth distance), largest of 100,000
        pairs: float64 1e-8 at spreads (see `overlap`) to 40 and 1e-5 to 1000, 99.9 %
        within 1e-11; float32 2e-6 and 3e-5, 99.9 % within 5e-7 and 3e-6. Of 1,000,000
        pairs to 1000 in float64 6e-5 at 5 steps, 1e-6 at 6 and 4e-14 at 7.

        Derivatives, forward and reverse, are those of the margin at the direction
        found (envelope theorem): exact once the steps have converged, and finite. In
        the single entries of the axes, which a rotation cannot vary alone, they are
        those of the support functions (see `jaxbe.envelope`), as if the value were
        computed from S alone. At coincident centres, the tip of a cone, they are zero,
        which is a subgradient. In float32 they can be those of a neighbouring contact
        at aspect ratios of 1e6 and more, and those in the semi-axes of thin plates lose
        digits from 100 on (`benchmarks/results/extremes-cpu.md`). Second derivatives
        are right wherever they exist, and one-sided where the contact changes between
        face, edge and vertex.

    Raises:
        TypeError: arguments that are not a Box and an Ellipsoid of one dtype, or
            steps that are not a Python integer.
        ValueError: batch shapes that do not broadcast, or steps out of range.

    Source:
        C. J. Ong and E. G. Gilbert, "Growth distances", 1996; section 5 of the
        paper for the Minkowski sum and the slab box.
    """
    return growth_distance(box, ellipsoid, as_count("steps", steps, 0, MAX_STEPS)) - 1


def margin_bounds(
    box: Box, ellipsoid: Ellipsoid, *, steps: int = DEFAULT_STEPS
) -> tuple[Scalars, Scalars]:
    """A lower and an upper bound of the margin.

    The lower bound is `margin` itself, from a direction; the upper comes from a point
    that both grown bodies have in common. In exact arithmetic they hold at every
    number of steps, and neither loosens with more. Rounding can move either past
    the margin by `rounding_slack` times max(1, growth distance).

    Args:
        box: any batch shape.
        ellipsoid: a batch shape that broadcasts with the box's.
        steps: as for `margin`.

    Returns:
        (lower, upper), each of the common batch shape, lower <= upper; NaN if any
        number is NaN or infinite. Not made to be differentiated.

    Raises:
        TypeError: as `margin`.
        ValueError: as `margin`.
    """
    pair = canonical_pair(box, ellipsoid)
    bounds = growth_bounds(pair, as_count("steps", steps, 0, MAX_STEPS))
    lower, upper = _xla.materialise_two(*bounds, runtime_witness(pair))
    return lower - 1, upper - 1


def rounding_slack(dtype: Any, aspect_ratio: float, *, axes_error: float = 4) -> float:
    """How far above zero rounding can lift the margin of a pair that overlaps.

    A filter that drops only pairs with margin(steps=s) > rounding_slack loses none, at
    any s, NaN included. It is 112 eps times the aspect ratio by default, some sixty
    times what is observed; 15 times where all quotients and roots are 3 units in the
    last place off, to the wrong side, as they can be on accelerators. Lengths of which
    squares underflow are not counted: below some 1e-32 m where subnormal numbers are
    flushed to zero, in float32.

    Derivation, to first order, with u = eps / 2 and r the aspect ratio. The value
    computed is (q + alpha E) / (E + sqrt(q)) for the residuals (d_i, r_j, r_l) and the
    multipliers n made of them. Any n gives a lower bound, so only what separates this
    expression from n.k / (e.|n| + sqrt(n^T S n)) counts. Errors of residuals act like a
    shift of k, which moves alpha by the gauge of the shift, at most its length over
    the smallest semi-axis; for overlapping pairs |k| is at most (1 + sqrt(3)) times
    the longest length. In units of u r:

        U^T (K - C), 4 roundings a component                                19
        U^T V, 3 roundings an entry                                          9
        residuals in the plane and on the line                         16 + 10
        entries of S and of D2 N behind them, 12 roundings each        12 + 24
        the same in the length of n, and its own sums                  36 + 13
        axes orthonormal to axes_error eps only: N is not quite S^-1  7.5 each
        complementarity, n.x against alpha E (the kernel's key)              6
        quotients and roots off by 3 units in the last place, not by half,
        5 more for each: 1 + 2 behind the residuals, 3.5 and the root in
        the length of n, 1 for the quotient                               42.5

    together 187.5 and, with an axes_error of 4, 217.5: less than 112 eps r.
    The choice of the best candidate adds nothing: q plus the gap is compared, so the
    gap of the chosen one is of the order of the above.

    Args:
        dtype: float32 or float64, of the inputs.
        aspect_ratio: the longest half extent or semi-axis over the shortest semi-axis.
        axes_error: by how many eps the axes may differ from orthonormal. 4 suffices
            for `from_quaternion` and MuJoCo C; MJX in float32 drifts to tens along a
            chain of bodies.

    Returns:
        The slack, dimensionless.

    Raises:
        TypeError: another dtype, or what is not a number.
        ValueError: an aspect ratio below one, or an error below zero.
    """
    if str(np.dtype(dtype)) not in DTYPES:
        raise TypeError(f"dtype must be {' or '.join(DTYPES)}, got {np.dtype(dtype)}")
    ratio = as_number("aspect_ratio", aspect_ratio)
    error = as_number("axes_error", axes_error)
    if not ratio >= 1:
        raise ValueError(f"aspect_ratio must be at least 1, got {aspect_ratio}")
    if not error >= 0:
        raise ValueError(f"axes_error must not be negative, got {axes_error}")
    roundings = ARITHMETIC_ROUNDINGS + AXES_ROUNDINGS * error
    return roundings * float(np.finfo(dtype).eps) * ratio
