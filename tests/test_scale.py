"""One program over many devices and over several processes: each does its own part."""

import json

import jax
import numpy as np
import pytest

import jaxbe
from tests.on_devices import EACH
from tests.on_processes import own_fields
from tests.processes import Failed, cooperating, python, together

DEVICES = 8


def on_devices(axis_type, dtype):
    run = ("-m", "tests.on_devices", axis_type, dtype)
    return json.loads(python(*run, devices=DEVICES))


def check_share(kernel, told, roundings=100.0, flops=1e-3):
    """A device does an eighth of the work, on its own rows, and sends nothing."""
    assert told["collectives"] == [], kernel
    assert told["whole arrays"] == 0, kernel
    assert told["parts"] > 0, kernel
    assert told["rows"] == [EACH], kernel
    assert told["devices"] == [DEVICES], kernel
    assert told["roundings"] <= roundings, kernel
    np.testing.assert_allclose(told["flops"], 1 / DEVICES, rtol=flops, err_msg=kernel)


# One test a program: its compilations take most of the time.
def test_a_device_does_its_share_and_sends_nothing():
    told = on_devices("Auto", "float32")
    check_share("overlap", told.pop("overlap"), roundings=0)
    check_share("example", told.pop("example"), roundings=0, flops=2e-2)
    assert told.pop("sum")["collectives"] == ["all-reduce"]
    assert sorted(told) == ["contact", "gradient", "margin", "one box"]
    for kernel in told:
        check_share(kernel, told[kernel])


@pytest.mark.bulk
def test_so_it_does_where_shardings_are_types():
    told = on_devices("Explicit", "float64")
    check_share("overlap", told.pop("overlap"), roundings=0)
    assert sorted(told) == ["gradient", "margin", "one box"]
    for kernel in told:
        check_share(kernel, told[kernel])


@pytest.mark.bulk
@pytest.mark.skipif(not hasattr(jax, "set_mesh"), reason="older: no axis is explicit")
@pytest.mark.parametrize(
    "every", [(), pytest.param(("every",), marks=pytest.mark.slow)]
)
def test_vmap_over_an_axis_that_is_part_of_the_types(every):
    """As `jax.make_mesh` makes it by default; once a ShardingTypeError."""
    run = ("-m", "tests.on_explicit_mesh", *every)
    told = json.loads(python(*run, devices=4, seconds=1200))
    assert told.pop("roundings") <= 100
    assert {name: fault for name, fault in told.items() if fault} == {}


def test_two_processes():
    each, devices = 96, 2
    outputs = cooperating(
        lambda port, process: ("-m", "tests.on_processes", port, process, 2, each),
        devices=devices,
    )
    expected = [overlaps(own_fields(process, each)) for process in range(2)]
    assert all(0 < count < each for count in expected)
    for output, here in zip(outputs, expected, strict=True):
        told = json.loads(output.splitlines()[-1])
        assert (told["devices"], told["local devices"]) == (2 * devices, devices)
        assert (told["here"], told["in all"]) == (here, sum(expected))
        for kernel in ("overlap", "margin"):
            assert told[kernel]["collectives"] == []
            assert told[kernel]["pairs"] == 2 * each
            assert told[kernel]["rows"] == [each // devices]
            assert told[kernel]["roundings"] <= (0 if kernel == "overlap" else 100)


def overlaps(fields):
    bodies = jaxbe.Box(*fields[0]), jaxbe.Ellipsoid(*fields[1])
    return int(jax.jit(jaxbe.overlap)(*bodies).sum())


def example(*arguments, **options):
    """The numbers that `examples/many_devices.py` prints: overlaps and pairs."""
    command = ("examples/many_devices.py", "--pairs", 500, "--batches", 4, *arguments)
    return read(python(*command, **options))


def read(output):
    overlaps, _, _, pairs, *rest = output.splitlines()[-1].split()
    assert rest[0] == "pairs,"
    assert rest[2:4] == ["M", "pairs/s,"]
    assert float(rest[1]) >= 0
    return int(overlaps), int(pairs), " ".join(rest[4:])


def test_the_example_finds_the_same_on_two_devices_and_in_two_processes():
    overlaps, pairs, where = example(devices=2)
    assert pairs == 2 * 500 * 4
    assert 0.2 * pairs < overlaps < 0.4 * pairs
    assert where == "2 devices (cpu) of 1 processes"

    def command(port, process):
        run = ("examples/many_devices.py", "--pairs", 500, "--batches", 4)
        found = ("--coordinator", f"127.0.0.1:{port}", "--processes", 2)
        return (*run, *found, "--process", process)

    first, second = cooperating(command)
    assert read(first) == (overlaps, pairs, "2 devices (cpu) of 2 processes")
    assert "overlaps" not in second


def test_processes_end_when_one_fails_or_time_is_up():
    wait = ("-c", "import time; time.sleep(60)")
    with pytest.raises(Failed, match="in one of them"):
        together([wait, ("-c", "raise SystemExit('in one of them')")], 1, 30)
    with pytest.raises(Failed, match="sleep"):
        together([wait], 1, 0.5)
