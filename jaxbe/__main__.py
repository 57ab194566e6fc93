"""`python -m jaxbe`: the command line."""

import contextlib
import os
import sys

if __name__ == "__main__":
    # Python's -m looks for modules in the current folder first, where a `mujoco.py` may
    # lie beside a scene. (JAX and NumPy came before this: python -P guards them too.)
    with contextlib.suppress(OSError):  # A folder that is deleted is no danger.
        if not sys.flags.safe_path and sys.path[0] in ("", os.getcwd()):
            del sys.path[0]
    from jaxbe.cli import main

    sys.exit(main())
