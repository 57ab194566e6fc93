"""Boxes and ellipsoids of MuJoCo models, for MJX and Brax.

Works with `mujoco.MjModel` and `mjx.Model` alike, and reads only their public
fields; importing this module needs neither.
"""

from jaxbe.mjx.filter import Candidates, filter_contacts
from jaxbe.mjx.gather import gather
from jaxbe.mjx.pairs import Pairs, find_pairs

__all__ = ["Candidates", "Pairs", "filter_contacts", "find_pairs", "gather"]
