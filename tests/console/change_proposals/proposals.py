"""Changes that wait for a second person, for requests about them."""

from collections.abc import Callable
from typing import Any

from boresight.console.access import users
from boresight.console.change_proposals import service as proposals
from boresight.platform.actors import Policy
from boresight.platform.db.sessions import open_reading, open_writing
from tests.served import House

Made = tuple[str, dict[str, Any]]  # who asks, and path values with request options
TIGHT = {"gates": [{"name": "coverage", "limit": 0.25}]}


def proposed(house: House, who: str = "ada") -> dict[str, Any]:
    row = house.new_sensor()
    fields = [
        {"name": f"F{place}", "parameter": name, "offset_bytes": 4 * place, "type": "float32"}
        for place, name in enumerate(row["document"]["initial"])
    ]
    document = {"table_id": "T", "flight_software_version": "1", "length_bytes": 32, "fields": fields}
    engine = house.app.state.engine
    with open_reading(engine) as session:
        user = next(user for user in users.list_users(session) if user.name == who)
        actor = users.get_actor(session, user.id)
    with open_writing(engine) as session:
        asked = ("table-definition", row["id"], document, "Flight software 1.", 0)
        made = proposals.change(session, actor, *asked, policy=Policy(second_person=True))
    return {"id": made.id, "version": 1, "sensor_id": row["id"]}


def _decide(who: str, **body: Any) -> Callable[[House], Made]:
    def make(house: House) -> Made:
        row = proposed(house)
        options = {"proposal_id": row["id"], "headers": {"If-Match": '"v1"'}}
        return who, options | ({"json": body} if body else {})

    return make


GOOD: dict[str, Callable[[House], Made]] = {
    "list_change_proposals": lambda _: ("victor", {}),
    "get_change_proposal": lambda house: ("victor", {"proposal_id": proposed(house)["id"]}),
    "confirm_change": _decide("adele", comment="Seen."),
    "refuse_change": _decide("adele", comment="Not now."),
    "withdraw_change": _decide("ada"),
}
