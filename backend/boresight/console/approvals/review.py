"""The review of a request: the points against it, and what a signature says of each of them.

A point is a gate that is not PASS, a warning, or a figure of the run that an approver must have opened. Gates and warnings are
closed by a reason, a figure by having been read under this request, or by a reason too. What a signature says of every point is
stored with it and sealed. An opening counts for the person whom the server gave the figure to, and for nobody else, once
it had been in their sight for a second.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from boresight.calibration.parameter_set import ParameterSetDocument, parse_parameter_set
from boresight.cameras.model import FAR_TYPICAL_SIGMAS
from boresight.console.approvals import queries as rows
from boresight.console.approvals.tables import Approval, GateReport
from boresight.console.fleet.tables import Sensor
from boresight.console.parameter_sets import queries as set_rows
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.errors import RefusedInputError
from boresight.platform.db.sessions import Session
from boresight.platform.web.text_validation import refuse_control_characters
from boresight.verdicts.gates import parse_report
from boresight.verdicts.gates.judgement import STATUSES

GATE, WARNING, EVIDENCE = KINDS = ("gate", "warning", "evidence")
#: The figures that are opened before signing, by name.
VIEWS = {
    "convergence": "Convergence",
    "rms": "RMS",
    "radial": "Radial difference",
    "observability": "Observability",
}
LONGEST_REASON = 1000
SHOWN_SIGMAS = 2.0  # from where on a rotation of the attitude is one that its data show


@dataclass(frozen=True)
class Acknowledgement:
    """A point that a signature accepts, and why; of a figure, why it was not opened."""

    kind: str
    name: str
    reason: str


@dataclass(frozen=True)
class Point:
    """Something that a signature must answer for, and how it did: `reason` or `opened_utc`; neither while it is open.

    `status`: the gate's answer; empty of warnings and figures.
    """

    kind: str
    name: str
    title: str
    said: str
    status: str = ""
    reason: str | None = None
    opened_utc: str | None = None

    @property
    def is_open(self) -> bool:
        """Whether nothing closed it."""
        return self.reason is None and self.opened_utc is None

    @property
    def answer(self) -> str:
        """How it was answered, as the audit log says it."""
        if self.opened_utc is not None:
            return f"opened {self.opened_utc}"
        return self.reason or "not answered"

    @property
    def key(self) -> tuple[str, str]:
        """Its kind and name, which tell it from others of the request."""
        return self.kind, self.name


def list_points(session: Session, approval: Approval, reader: int | None = None) -> list[Point]:
    """Return the points of a request, gates first, with the figures that a person opened."""
    row = session.get_one(ParameterSet, approval.parameter_set_id)
    opened = {one.evidence: one.opened_utc for one in rows.list_openings(session, approval.id) if one.user_id == reader}
    views = VIEWS if row.run_id is not None else {}
    return [
        *_list_gate_points(_find_bound_report(session, approval)),
        *_list_warnings(session, approval, row),
        *(
            Point(EVIDENCE, name, title, f"The figure {title} of this request.", opened_utc=opened.get(name))
            for name, title in views.items()
        ),
    ]


def _find_bound_report(session: Session, approval: Approval) -> GateReport | None:
    sha256 = approval.binding.gate_report_sha256
    return None if sha256 is None else rows.find_newest_report(session, approval.parameter_set_id, sha256)


def _list_gate_points(report: GateReport | None) -> list[Point]:
    """Return the gates that are not PASS, the worst first."""
    gates = [] if report is None else parse_report(report.document).gates
    against = sorted((gate for gate in gates if gate.status != "PASS"), key=lambda gate: -STATUSES.index(gate.status))
    return [Point(GATE, gate.name, gate.title, gate.sentence, gate.status) for gate in against]


def _list_warnings(session: Session, approval: Approval, row: ParameterSet) -> list[Point]:
    incumbent = None
    if (sha256 := approval.binding.incumbent_sha256) is not None:
        incumbent = set_rows.find_other_with_document(session, row, sha256)
    said = warn_of_set(session, row, incumbent)
    if row.run_id is None:
        said["ground-calibration"] = "This is a ground calibration: declared, not estimated from telemetry."
    return [Point(WARNING, name, "Warning", sentence) for name, sentence in said.items()]


def warn_of_set(session: Session, row: ParameterSet, incumbent: ParameterSet | None) -> dict[str, str]:
    """Return what an approver of a set is warned of besides its gates: its advice, far shifts and the turn of the attitude."""
    typical = session.get_one(Sensor, row.sensor_id).document["typical_sigma"]
    found = parse_parameter_set(row.document)
    old = {} if incumbent is None else parse_parameter_set(incumbent.document).parameters
    said: dict[str, str] = {f"advice-{i}": sentence for i, sentence in enumerate(found.coded_advice, 1)}
    return said | warn_of_shifts(found, old, typical) | warn_of_turn(found)


def warn_of_shifts(
    found: ParameterSetDocument, old: Mapping[str, float], typical_sigma: Mapping[str, float]
) -> dict[str, str]:
    """Return a warning of each estimated parameter that moves farther than sensors are known to."""
    said = {}
    for name, sigma in (found.sigma or {}).items():
        scale = typical_sigma.get(name)
        if sigma is None or not scale or name not in old:
            continue
        shift = abs(found.parameters[name] - old[name]) / scale
        if shift > FAR_TYPICAL_SIGMAS:
            said[f"shift-{name}"] = (
                f"{name} moves by {shift:.1f} typical sigmas, more than {FAR_TYPICAL_SIGMAS:g}: check the matches before "
                "trusting it."
            )
    return said


def warn_of_turn(found: ParameterSetDocument) -> dict[str, str]:
    """Return a warning where loading a set turns the reported attitude by more than chance, so that C_SD must be loaded with it."""
    turn = found.alignment
    if turn is None:
        return {}
    rotation, sigma = np.array(turn["rotation_arcsec"]), np.array(turn["sigma_of_mean_arcsec"])
    # along its own axis, n = r / |r|, the rotation has the variance n . diag(sigma^2) n
    if turn["consistent"] and rotation @ rotation <= SHOWN_SIGMAS * np.linalg.norm(rotation * sigma):
        return {}
    return {"attitude-turn": turn["sentence"]}


def answer_points(points: Sequence[Point], given: Sequence[Acknowledgement]) -> list[Point]:
    """Return the points with the reasons given; refuse a reason that is missing, twice there, or for no point."""
    known = {point.key for point in points}
    reasons: dict[tuple[str, str], str] = {}
    for one in given:
        key, reason = (one.kind, one.name), one.reason.strip()
        refuse_control_characters(reason=reason)
        if key not in known:
            raise RefusedInputError(
                f"This request has no point {one.kind} {one.name[:64]!r}; read its points and choose one of them."
            )
        if key in reasons:
            raise RefusedInputError(f"The {one.kind} {one.name!r} is acknowledged twice; leave one out.")
        if not reason or len(reason) > LONGEST_REASON:
            raise RefusedInputError(
                f"The {one.kind} {one.name!r} is acknowledged without a valid reason; write 1 to {LONGEST_REASON} characters."
            )
        reasons[key] = reason
    return [replace(point, reason=reasons.get(point.key)) for point in points]


def refuse_open_points(points: Sequence[Point]) -> None:
    """Refuse an approval that leaves a point open, naming the first."""
    left = [point for point in points if point.is_open]
    if not left:
        return
    first, more = left[0], f" {len(left) - 1} more points are open." if len(left) > 1 else ""
    if first.kind == EVIDENCE:
        raise RefusedInputError(
            f"{first.title} was not opened: open it, or give a reason for signing without it.{more}"
        )
    what = f"{first.title} is {first.status}" if first.kind == GATE else f"A warning says: {first.said}"
    raise RefusedInputError(f"{what.rstrip('.')}. Acknowledge it, with the reason why you accept it.{more}")


def write_points(points: Sequence[Point]) -> list[dict[str, Any]]:
    """Write points as a signature stores them."""
    return [asdict(point) for point in points]


def read_points(stored: Sequence[Mapping[str, Any]] | None) -> list[Point]:
    """Read the points that a signature stores; none of signatures of before there were any."""
    return [Point(**point) for point in stored or ()]
