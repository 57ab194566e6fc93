"""Boxes and ellipsoids of MuJoCo models, for MJX and Brax.

Works with `mujoco.MjModel` and `mjx.Model` alike, and reads only their public
fields; importing this module needs neither. Only where a program asks for it,
with `collision_enabled`, is MJX's private table of collision functions written to.
"""

from jaxbe.mjx.collision import (
    collision_enabled,
    disable_collision,
    enable_collision,
)
from jaxbe.mjx.facts import scene_facts
from jaxbe.mjx.filter import Candidates, filter_contacts
from jaxbe.mjx.gather import gather
from jaxbe.mjx.pairs import Pairs, find_pairs

__all__ = [
    "Candidates",
    "Pairs",
    "collision_enabled",
    "disable_collision",
    "enable_collision",
    "filter_contacts",
    "find_pairs",
    "gather",
    "scene_facts",
]
