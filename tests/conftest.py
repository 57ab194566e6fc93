"""Both float types, with every implicit promotion an error."""

import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbe

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


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
