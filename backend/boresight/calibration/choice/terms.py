"""The terms of a camera: groups of parameters that are set free together, read off its file's roles.

A focal length is always free. Row and column of the principal point are one term, both tilts one, both decentrings one: alone
neither has a meaning, for it depends on how the detector lies. Tilt and tangential terms stand on the principal point: of a lens
with little distortion all three move the stars by nearly the same squares of the tangents, and no lens has its principal point
where a file says, so that a tilt without it would be the principal point by another name. Radial parameters are ordered by the
power of the radius that they act with, and each order stands on the lower ones; the power is measured on the camera itself, as the
slope of the logarithm of d tan(theta) / d parameter near the principal point. So a camera in a new file has its terms without
naming them anywhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from boresight.arrays import IntArray
from boresight.cameras import CameraModel
from boresight.cameras.model import Role

#: Focal length, pixels, of the plain camera on which orders are measured, and the radius from which they are.
FOCAL_PX, RADIUS_PX = 1000.0, 10.0
#: Names of terms whose parameters have more than one role, or another word than the role.
PRINCIPAL_POINT = "principal point"
NAMES = {Role.ROW: PRINCIPAL_POINT, Role.COLUMN: PRINCIPAL_POINT, Role.DECENTRING: "tangential"}
#: Roles whose terms stand on the principal point.
ASKEW = frozenset({Role.TILT, Role.DECENTRING})
POWERS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Term:
    """Parameters that are set free together, by their places in the state; `needs` names the term that must be free before."""

    name: str
    places: tuple[int, ...]
    needs: str | None = None


@dataclass(frozen=True)
class Subset:
    """A camera with some of its terms free; all others rest."""

    camera: CameraModel
    terms: tuple[Term, ...]

    @property
    def free(self) -> IntArray:
        """Places of the free parameters, ascending."""
        places = [self.camera.place(Role.FOCAL), *(place for term in self.terms for place in term.places)]
        return np.array(sorted(places), dtype=np.int64)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in parameter order."""
        return tuple(self.camera.parameter_names[place] for place in self.free)

    @property
    def term_names(self) -> tuple[str, ...]:
        """Names of the free terms, in the camera's order."""
        return tuple(term.name for term in self.terms)

    def extensions(self) -> tuple[Term, ...]:
        """Terms that may be set free next."""
        names = {None, *self.term_names}
        return tuple(term for term in find_terms(self.camera) if term.name not in names and term.needs in names)

    def removable(self) -> tuple[Term, ...]:
        """Terms that may be held again."""
        needed = {term.needs for term in self.terms}
        return tuple(term for term in self.terms if term.name not in needed)

    def with_term(self, term: Term) -> Subset:
        """Return the subset with one term more, in the camera's order."""
        return self._select({*self.term_names, term.name})

    def without_term(self, term: Term) -> Subset:
        """Return the subset with one term less."""
        return self._select(set(self.term_names) - {term.name})

    def contains(self, other: Subset) -> bool:
        """Whether this camera with these terms free can be all that the other is."""
        return self.camera is other.camera and set(other.term_names) <= set(self.term_names)

    def _select(self, names: Iterable[str]) -> Subset:
        wanted = set(names)
        return Subset(self.camera, tuple(term for term in find_terms(self.camera) if term.name in wanted))


def base(camera: CameraModel) -> Subset:
    """Return the camera of which nothing but the focal length is free."""
    return Subset(camera, ())


def largest(camera: CameraModel) -> Subset:
    """Return the camera of which everything is free."""
    return Subset(camera, find_terms(camera))


@lru_cache
def list_subsets(camera: CameraModel) -> tuple[Subset, ...]:
    """List every subset of a camera's terms in which each term stands on what it needs, fewer terms first."""
    terms = find_terms(camera)
    chosen = (some for count in range(len(terms) + 1) for some in combinations(terms, count))
    return tuple(
        Subset(camera, some) for some in chosen if {term.needs for term in some} <= {None, *(t.name for t in some)}
    )


@lru_cache
def find_terms(camera: CameraModel) -> tuple[Term, ...]:
    """List a camera's terms: principal point, radial orders from the lowest on, then the other roles as `Role` lists them."""
    order_by_place = radial_orders(camera)
    found: list[Term] = []
    for role in Role:
        if role is Role.FOCAL:
            continue
        if role is Role.RADIAL:
            before: str | None = None
            for order in sorted(set(order_by_place.values())):
                name = f"radial r{str(order).translate(POWERS)}"
                found.append(Term(name, tuple(place for place, of in order_by_place.items() if of == order), before))
                before = name
            continue
        name = NAMES.get(role, role.value)
        places = tuple(
            place for place, one in enumerate(camera.parameters) if NAMES.get(one.role, one.role.value) == name
        )
        if places and all(term.name != name for term in found):
            stands = role in ASKEW and any(term.name == PRINCIPAL_POINT for term in found)
            found.append(Term(name, places, PRINCIPAL_POINT if stands else None))
    return tuple(found)


def radial_orders(camera: CameraModel) -> dict[int, int]:
    """Power of the radius with which each radial parameter, by its place, moves the tangent."""
    x = camera.plain(FOCAL_PX, 0.0, 0.0, 1.0)
    _, gradient = camera.radial_tangent(x, np.array([RADIUS_PX, 2.0 * RADIUS_PX]), 1.0)
    places = [place for place, one in enumerate(camera.parameters) if one.role is Role.RADIAL]
    return {place: round(float(np.log2(gradient[1, place] / gradient[0, place]))) for place in places}
