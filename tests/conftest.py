"""Both float types, with every implicit promotion an error."""

import gc
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish():
    """Spares pytest's garbage collections at the end what JAX's programs left.

    They take seconds each, and xdist's workers have five to end: then they are
    interrupted, with a traceback after the last dot.
    """
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _programs_are_compiled_once(tmp_path_factory):
    """Whatever worker needs them: compiling takes most of the time of the tests."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    jax.config.update("jax_compilation_cache_dir", str(folder / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    return np.dtype(request.param)


@pytest.fixture
def quick_contact(monkeypatch):
    """Lets the command compute another contact, of the right sign.

    The true one takes ten seconds to compile, for every shape.
    """

    def contact(box, ellipsoid):
        ratio = jaxbe.scaled_distance(box, ellipsoid)
        point = jnp.broadcast_to(ellipsoid.center, (*ratio.shape, 3))
        up = jnp.broadcast_to(jnp.array([0, 0, 1], ratio.dtype), point.shape)
        smallest = jnp.broadcast_to(ellipsoid.semi_axes.min(axis=-1), ratio.shape)
        return jaxbe.Contact((ratio - 1) * smallest, point, up, point, point)

    monkeypatch.setattr("jaxbe.cli.sweep.contact", contact)


@pytest.fixture
def stand_in_tests(monkeypatch):
    """Lets the command compare distances of centres: nothing is compiled."""
    # Only here, for where there is no mujoco.
    from jaxbe.cli.sweep import Tests

    def ratio(box, ellipsoid):
        with np.errstate(over="ignore"):
            return np.linalg.norm(box - ellipsoid, axis=-1)

    def contact(box, ellipsoid):
        points = box, np.broadcast_to([0.0, 0.0, 1.0], box.shape), box, ellipsoid
        return jaxbe.Contact(ratio(box, ellipsoid) - 1, *points)

    def compile_tests(pairs, model, poses):
        timed = dict.fromkeys(jaxbe.METHODS, lambda b, e: ratio(b, e) <= 1)
        timed |= {
            "contact": contact,
            "certify": lambda b, e: np.sign(1 - ratio(b, e)).astype(int),
        }
        return Tests(
            gather=lambda poses: tuple(
                poses.geom_xpos[:, pairs.geom[:, i]] for i in (1, 0)
            ),
            timed=timed,
            scaled_distance=ratio,
            margin=lambda b, e: ratio(b, e) - 1,
            compile_seconds=dict.fromkeys(timed, 0.0),
        )

    monkeypatch.setattr("jaxbe.cli.sweep.compile_tests", compile_tests)
    monkeypatch.setattr(
        "jaxbe.cli.crosscheck.scaled_distance",
        lambda box, ellipsoid: ratio(box.center, ellipsoid.center),
    )


@pytest.fixture(params=["closest_features", "all_features", "minkowski"])
def method(request):
    return request.param


@pytest.fixture
def jax_as_users_have_it():
    """Brax and MJX mix dtypes and ranks, and train in float32."""
    with (
        jax.enable_x64(False),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield
