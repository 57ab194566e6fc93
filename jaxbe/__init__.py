"""Does an oriented box touch an oriented ellipsoid, by how much, which way out?"""

from jaxbe.certify import Certificate, certify
from jaxbe.checked import checked
from jaxbe.chunked import chunked
from jaxbe.contact import Contact, contact
from jaxbe.distance import distance_bounds, signed_distance
from jaxbe.margin import margin, margin_bounds, rounding_slack
from jaxbe.overlap import METHODS, overlap
from jaxbe.plan import Plan, plan
from jaxbe.scaled_distance import scaled_distance
from jaxbe.scene_facts import SceneFacts, scene_facts
from jaxbe.shapes import Box, Ellipsoid

__version__ = "0.1.0"

__all__ = [
    "METHODS",
    "Box",
    "Certificate",
    "Contact",
    "Ellipsoid",
    "Plan",
    "SceneFacts",
    "certify",
    "checked",
    "chunked",
    "contact",
    "distance_bounds",
    "margin",
    "margin_bounds",
    "overlap",
    "plan",
    "rounding_slack",
    "scaled_distance",
    "scene_facts",
    "signed_distance",
]
