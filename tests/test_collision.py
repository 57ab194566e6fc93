"""The switch: MJX's table of collision functions, on and off again."""

import contextlib
import importlib.metadata
import re
import subprocess
import sys
import threading

import pytest
from mujoco import mjx
from mujoco.mjx._src import collision_driver

from jaxbe.mjx import collision_enabled, disable_collision, enable_collision
from jaxbe.mjx.driver import PAIR
from tests.in_mjx import assert_mjx_refuses, model_of, registered, table


@pytest.fixture(autouse=True)
def before():
    """The table's items; it must have them again after the test."""
    items = list(table().items())
    assert PAIR not in dict(items)
    yield items
    assert list(table().items()) == items


def test_inside_the_block_mjx_takes_the_model_and_outside_it_does_not():
    model = model_of()
    assert_mjx_refuses(model)
    with collision_enabled():
        on_device = mjx.put_model(model)
        mjx.make_data(model)
        mjx.make_data(on_device)
    assert_mjx_refuses(model)


def test_blocks_nest():
    with collision_enabled():
        function = registered()
        with collision_enabled(), collision_enabled():
            assert registered() is function
        assert registered() is function
    assert PAIR not in table()


def test_an_exception_ends_the_block(before):
    def fail():
        with collision_enabled(), collision_enabled():
            raise ArithmeticError

    with pytest.raises(ArithmeticError):
        fail()
    assert list(table().items()) == before
    with collision_enabled():
        with pytest.raises(ArithmeticError):
            fail()
        assert PAIR in table()


def test_decorator():
    @collision_enabled()
    def is_there():
        return PAIR in table()

    assert is_there()
    assert is_there()
    assert PAIR not in table()


def test_switch_is_on_or_off_however_often_it_is_turned():
    disable_collision()
    enable_collision()
    enable_collision()
    assert PAIR in table()
    disable_collision()
    assert PAIR not in table()
    disable_collision()


def test_switch_and_blocks_together():
    with collision_enabled():
        enable_collision()
        disable_collision()
        assert PAIR in table()
    enable_collision()
    with collision_enabled():
        pass
    assert PAIR in table()
    with collision_enabled():
        disable_collision()
        assert PAIR in table()
    assert PAIR not in table()


def test_a_function_that_is_there_stays(monkeypatch):
    def native():
        pass

    monkeypatch.setitem(table(), PAIR, native)
    with pytest.warns(UserWarning, match="its own function is left in place"):
        enable_collision()
    with pytest.warns(UserWarning, match="left in place"), collision_enabled():
        assert registered() is native
    disable_collision()
    assert registered() is native
    monkeypatch.undo()


def test_a_native_function_of_any_version_will_do(monkeypatch):
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "3.99.0")
    monkeypatch.setitem(table(), PAIR, print)
    with pytest.warns(UserWarning, match="left in place"), collision_enabled():
        assert registered() is print
    assert registered() is print
    monkeypatch.undo()


def test_a_function_that_came_later_stays():
    with collision_enabled():
        table()[PAIR] = print
    assert registered() is print
    del table()[PAIR]


@pytest.mark.parametrize("version", ["3.3.5", "3.3.10", "3.4.0.dev1", "3.17.0", "3.17"])
def test_supported_versions(monkeypatch, recwarn, version):
    monkeypatch.setattr(importlib.metadata, "version", lambda _: version)
    with collision_enabled():
        assert PAIR in table()
    assert not recwarn.list


@pytest.mark.parametrize("version", ["3.18.0", "3.18.0.dev1", "4.0.0", "10.1"])
def test_newer_versions_work_with_a_warning(monkeypatch, version):
    """As long as the table is as expected."""
    monkeypatch.setattr(importlib.metadata, "version", lambda _: version)
    message = rf"mujoco-mjx {re.escape(version)} is newer than .*3\.17"
    with pytest.warns(UserWarning, match=message) as caught, collision_enabled():
        mjx.put_model(model_of())
    assert [w.filename for w in caught] == [__file__]
    with pytest.warns(UserWarning, match=message):
        enable_collision()
    disable_collision()
    monkeypatch.setattr(collision_driver, "_COLLISION_FUNC", {})
    with pytest.raises(RuntimeError, match=f"not as jaxbe expects.*{version}"):
        enable_collision()
    monkeypatch.undo()


def warned_by(enable):
    with pytest.warns(UserWarning, match="left in place") as caught:
        enable()
    return [(w.filename, w.lineno) for w in caught]


def test_warnings_name_the_line_that_enabled(monkeypatch):
    """Whichever way it did: a block, a decorator, a stack of blocks, the switch."""
    monkeypatch.setitem(table(), PAIR, print)

    def block():
        with collision_enabled():
            pass

    def stack():
        with contextlib.ExitStack() as blocks:
            blocks.enter_context(collision_enabled())

    decorated = collision_enabled()(lambda: None)

    def decorator():
        decorated()

    for enable in (block, stack, decorator, enable_collision):
        [(filename, line)] = warned_by(enable)
        assert filename == __file__
        if enable is not enable_collision:
            first = enable.__code__.co_firstlineno
            assert first < line <= first + 2
    disable_collision()
    monkeypatch.undo()


@pytest.mark.parametrize("version", ["3.3.4", "3.2.7", "2.9", "?"])
def test_other_versions(monkeypatch, version):
    monkeypatch.setattr(importlib.metadata, "version", lambda _: version)
    for enable in (enable_collision, collision_enabled().__enter__):
        with pytest.raises(RuntimeError, match=r"3\.3\.5 to 3\.17 .* got") as error:
            enable()
        assert str(error.value).endswith(version)
    monkeypatch.undo()
    assert PAIR not in table()


def test_a_version_that_nobody_knows(monkeypatch):
    def unknown(_):
        raise importlib.metadata.PackageNotFoundError

    monkeypatch.setattr(importlib.metadata, "version", unknown)
    with pytest.raises(RuntimeError, match="got an unknown version"):
        enable_collision()


def test_mjx_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.mjx._src", None)
    with pytest.raises(ImportError, match=r"pip install 'jaxbe\[mjx\]'"):
        enable_collision()


def of_other_arguments(model, data, geom):
    """A collision function as it may look in a later MJX."""


of_other_arguments.ncon = 1


@pytest.mark.parametrize(
    "other",
    [None, [], {}, {(4, 4): print}, {(4, 4): 1}, {(4, 4): of_other_arguments}],
)
def test_a_table_that_is_not_as_expected(monkeypatch, other):
    monkeypatch.setattr(collision_driver, "_COLLISION_FUNC", other)
    with pytest.raises(RuntimeError, match="not as jaxbe expects"):
        enable_collision()
    monkeypatch.delattr(collision_driver, "_COLLISION_FUNC")
    with pytest.raises(RuntimeError, match="not as jaxbe expects"):
        enable_collision()
    monkeypatch.undo()
    monkeypatch.delattr("mujoco.mjx._src.math.make_frame")
    with pytest.raises(RuntimeError, match="not as jaxbe expects"):
        enable_collision()
    monkeypatch.undo()


def test_threads(before):
    """Whoever is in a block has the pair, whatever the others do."""
    missing, start = [], threading.Barrier(8)

    def enter_and_leave():
        start.wait()
        for _ in range(300):
            with collision_enabled():
                missing.append(PAIR not in table())

    threads = [threading.Thread(target=enter_and_leave) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(missing) == 2400
    assert not any(missing)
    assert list(table().items()) == before


def test_importing_jaxbe_imports_neither_mujoco_nor_mjx():
    code = "import sys, jaxbe.mjx; print('mujoco' in sys.modules)"
    run = [sys.executable, "-c", code]
    assert subprocess.check_output(run, text=True, timeout=120).strip() == "False"
