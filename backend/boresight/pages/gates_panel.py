"""The panel of gates that the pages of a set, of a request and of the gates themselves share.

`panel_of` fills it, the macro `gates_panel` of `approvals/gates_panel.html` prints it. Its forms post to `gate_report`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from boresight.services import gate_profiles, gates, users, waivers
from boresight.services.actors import Actor
from boresight.store.sessions import Session, utc_now
from boresight.store.tables import GateReport, ParameterSet, Waiver
from boresight.verdicts.gates.table import GateRow, gate_rows

USUAL_DAYS = 7
ONLY_WAIVERS = "Only an analyst or an approver may waive a gate; ask an administrator for the role."
ONLY_ASSESSORS = "A viewer may not assess sets; ask an administrator for a role."


@dataclass(frozen=True)
class Typed:
    """What a waiver's form held when it was refused."""

    gate: str = ""
    code: str = ""
    reason: str = ""
    days: str = str(USUAL_DAYS)


@dataclass(frozen=True)
class GatesPanel:
    """Everything that the panel shows.

    Parameters
    ----------
    set
        Whose gates these are.
    report
        The report that is shown; None where the set was never assessed.
    moved
        What moved of all that it rests on; empty while it holds.
    words, verdict
        The verdict with its waivers, and without.
    rows
        The gates, in words.
    assessed_by
        Printed name of who assessed the set.
    profile_number
        Version of the limits in force.
    given
        Every waiver that the set was ever given, and whether it holds now.
    may_assess, may_waive
        None where the actor may, else why not.
    waivable
        Gates that block and that a person may waive.
    codes, least_letters, longest_days
        What a waiver needs.
    typed
        What stands in the form.
    """

    set: ParameterSet
    report: GateReport | None
    moved: Sequence[str]
    words: str
    verdict: str
    rows: Sequence[GateRow]
    assessed_by: str
    profile_number: int
    given: Sequence[tuple[Waiver, bool]]
    may_assess: str | None
    may_waive: str | None
    waivable: Sequence[GateRow]
    codes: dict[str, str] = field(default_factory=lambda: waivers.CODES)
    least_letters: int = waivers.LEAST_LETTERS
    longest_days: int = waivers.LONGEST_DAYS
    typed: Typed = Typed()

    @property
    def blocking(self) -> Sequence[GateRow]:
        """Gates that stop the set now."""
        return [row for row in self.rows if row.blocking]


def panel_of(
    session: Session,
    actor: Actor,
    row: ParameterSet,
    typed: Typed | None = None,
    report_sha256: str | None = None,
) -> GatesPanel:
    """Fill the panel of a set, as an actor sees it.

    Parameters
    ----------
    typed
        What a refused form held.
    report_sha256
        Of the report to show, as a request binds it; the newest where none is named.
    """
    report = gates.newest_report(session, row.id, report_sha256)
    moved = [] if report is None else gates.moved_since(session, report)
    document = None if report is None else gates.with_waivers(session, report)
    rows = [] if document is None else gate_rows(document)
    now = utc_now()
    return GatesPanel(
        set=row,
        report=report,
        moved=moved,
        words="" if document is None else document["words"],
        verdict="" if document is None else document["verdict"],
        rows=rows,
        assessed_by=_name(session, report),
        profile_number=gate_profiles.profile_in_force(session, row.sensor_id).number,
        given=[(waiver, waiver.expires_utc > now) for waiver in waivers.all_waivers(session, row.id)],
        may_assess=None if actor.roles.intersection(gates.ASSESSORS) else ONLY_ASSESSORS,
        may_waive=None if actor.roles.intersection({"analyst", "approver"}) else ONLY_WAIVERS,
        waivable=[one for one in rows if one.blocking and one.waivable and not moved],
        typed=typed or Typed(),
    )


def _name(session: Session, report: GateReport | None) -> str:
    """Return who assessed the set."""
    if report is None or report.created_by is None:
        return "Boresight"
    return users.get_user(session, report.created_by).printed_name
