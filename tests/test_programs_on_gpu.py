"""Programs for an H100 that is not there keep their limits (extra `compilers`)."""

import jax
import pytest

from benchmarks import programs, programs_report

SECONDS = 500


@pytest.mark.compilers
@pytest.mark.parametrize(
    "name",
    [
        "overlap, closest_features",
        "overlap, all_features",
        "overlap, minkowski",
        "margin and gradients, 5 steps",
        "signed_distance, 3 steps",
        "contact, 3 steps",
    ],
)
def test_programs_keep_their_limits(name):
    row = programs.measure("h100", name, 1 << 20, "float32", SECONDS)
    # Fails where the compilers are missing: who asks for this wants it done.
    assert "error" not in row, row["error"]
    # Seconds are not for tests.
    over = programs_report.exceeded(row | {"compile_seconds": 0}, jax.__version__)
    assert not over
    # Else the sums would lack something.
    assert programs_report.facts(row)["launched"] == str(len(row["kernels"]))
