"""What the pages of a set offer to whom, in every state on its way, is what the server would accept: no more and no less."""

import re

import pytest

from boresight.console.approvals import staleness
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.platform.db.sessions import open_reading, utc_after
from tests.console.approvals.gates import TIGHT
from tests.console.pages.offers import REASON, Offers, is_accepted
from tests.console.parameter_sets.test_pages import TURNED
from tests.console.uplinks.pages import advance, define, table
from tests.sites import PASSWORD, answer_points

NAMES = ("ada", "alan", "olga", "adele", "victor", "both")


def offered(visitor, set_id, request_id):
    """The acts on a set and its request that its pages offer somebody."""
    place, found = f"/parameter-sets/{set_id}", []
    pages = [place, f"{place}/gates", f"{place}/uplink", *([f"/approvals/{request_id}"] if request_id else [])]
    for page in pages:
        for address, fields in Offers(visitor.get(page)).reachable():
            act = re.sub(rf"^({place}|/approvals/{request_id})(/uplink)?/", "", address.partition("#")[0])
            if act in {"sign", "sign-over-the-shoulder"}:
                act = f"{act} {fields.get('decision')}"
            elif act == "record":
                beside = fields["onboard_state"] == visitor.send("GET", f"/api/v1{place}").json()["onboard_state"]
                act = "record C_SD" if beside else f"record {fields['onboard_state']}"
            elif act == "read-back":
                found += ["read-back by dump", *(["read-back by CRC"] if "crc" in fields else [])]
            found.append(act)
    return set(found) & set(ACTS)


ACTS = {
    "submit": ("set", "submit", {"reason": REASON}),
    "roll-back": ("set", "roll-back", {"reason": REASON}),
    "withdraw": ("set", "withdraw", {}),
    "promote": ("set", "promote", {"reason": REASON}),
    "assess": ("set", "assess", None),
    "waive": (
        "set",
        "waive",
        {"gate": TIGHT["name"], "code": "limit-too-tight", "reason": REASON, "password": PASSWORD},
    ),
    "sign APPROVE": ("request", "approve", {"meaning": "Read.", "password": PASSWORD}),
    "sign REFUSE": ("request", "refuse", {"meaning": "Read.", "comment": REASON, "password": PASSWORD}),
    "package": ("set", "export", {}),
    "record SENT": ("record", "SENT", {}),
    "record LOADED": ("record", "LOADED", {}),
    "record MISMATCH": ("record", "MISMATCH", {}),
    "record UNKNOWN": ("record", "UNKNOWN", {}),
    "record C_SD": ("record", "", {"c_sd": "NOT YET"}),
    "read-back by dump": ("read", "dump", {}),
    "read-back by CRC": ("read", "crc", {}),
    "activate": ("set", "activate", {"source": "TM", "meaning": "Seen.", "password": PASSWORD}),
}


def accepted(site, visitor, set_id, request_id):
    """The acts that the server would accept from somebody now, by dry runs over REST."""
    with open_reading(site.engine) as session:
        row = session.get_known(ParameterSet, set_id)
        seen, was_baseline, on_board = row.version, row.baseline_from_utc is not None, row.onboard_state
    request_version = visitor.send("GET", f"/api/v1/approvals/{request_id}").json()["version"] if request_id else None

    def tried(act):
        kind, verb, body = ACTS[act]
        if kind == "request" and request_id is None:
            return False
        place = f"/api/v1/approvals/{request_id}" if kind == "request" else f"/api/v1/parameter-sets/{set_id}"
        version = request_version if kind == "request" else seen
        options = {"headers": {"If-Match": f'"v{version}"', "X-CSRF-Token": visitor.csrf_token}}
        if kind == "record":
            place = "/api/v1/uplinks"
            options["json"] = {
                "parameter_set_id": set_id,
                "onboard_state": verb or on_board,
                "source": "Pass 1",
                **body,
            }
        elif kind == "read":
            place = f"{place}:read-back"
            options["data"] = {"source": "Pass 1", **({"crc": "0"} if verb == "crc" else {})}
            options["files"] = {"file": ("dump.bin", table(site, set_id))} if verb == "dump" else None
        else:
            place = f"{place}:{verb}"
            if body is not None:
                options["json"] = body | ({"expires_utc": utc_after(3600.0)} if verb == "waive" else {})
        answer = visitor.send("POST", place, params={"validate_only": "true"}, **options)
        return is_accepted(act, answer)

    acts = set(ACTS) - ({"submit"} if was_baseline else set())  # a former baseline goes back by a roll-back
    return {act for act in acts if tried(act)}


class Life:
    """A set and its newest request on their way, one step at a time."""

    def __init__(self, site, run_id=1) -> None:
        self.site, self.request_id = site, None
        self.people = {name: site.visitor(name) for name in NAMES}
        self.set_id = int(
            self.people["ada"].post(f"/runs/{run_id}/parameter-set").headers["location"].rpartition("/")[2]
        )
        define(site)

    @property
    def place(self) -> str:
        return f"/parameter-sets/{self.set_id}"

    def _version(self) -> str:
        with open_reading(self.site.engine) as session:
            return str(session.get_known(ParameterSet, self.set_id).version)

    def act(self, who, verb, **form):
        answer = self.people[who].post(f"{self.place}/{verb}", version=self._version(), **form)
        assert answer.status_code == 303, answer.text
        if "/approvals/" in answer.headers["location"]:
            self.request_id = int(answer.headers["location"].rpartition("/")[2])

    def sign(self, who, decision):
        alan, place = self.people[who], f"/approvals/{self.request_id}"
        form = {"decision": decision, "comment": REASON, "password": PASSWORD, **answer_points(alan.get(place))}
        version = alan.send("GET", f"/api/v1{place}").json()["version"]
        assert alan.post(f"{place}/sign", version=str(version), **form).status_code == 303

    def promoted(self):
        self.act("ada", "submit", reason=REASON)
        self.sign("alan", "APPROVE")
        self.act("olga", "promote", reason=REASON, password=PASSWORD)

    def record(self, *states):
        advance(self.site, *states, set_id=self.set_id)

    def tighten(self):
        adele, body = self.people["adele"], {"gates": [TIGHT], "reason": REASON}
        headers = {"If-Match": '"v0"', "X-CSRF-Token": adele.csrf_token}
        answer = adele.send("POST", "/api/v1/sensors/1/gate-profiles", json=body, headers=headers)
        assert answer.status_code == 201, answer.text

    def holds(self, state, *names, asked_with_loaded=False):
        for name in names or NAMES:
            visitor = self.people[name]
            pages, server = (
                offered(visitor, self.set_id, self.request_id),
                accepted(self.site, visitor, self.set_id, self.request_id),
            )
            server -= {"record C_SD"} if asked_with_loaded else set()
            assert pages == server, f"{state}, {name}: offered {pages - server}, hidden {server - pages}"


@pytest.fixture
def life(site):
    return Life(site)


def test_on_the_ground_the_pages_offer_what_the_server_accepts(life):
    life.holds("CANDIDATE")
    life.act("ada", "submit", reason=REASON)
    life.holds("SUBMITTED")
    life.act("ada", "withdraw")
    life.holds("WITHDRAWN")
    life.act("ada", "submit", reason=REASON)
    life.sign("alan", "REFUSE")
    life.holds("REJECTED")


def test_with_gates_in_the_way_the_pages_offer_what_the_server_accepts(life):
    life.tighten()
    life.act("ada", "assess")
    life.holds("CANDIDATE that a gate stops")
    life.act("ada", "submit", reason=REASON)
    life.holds("SUBMITTED that a gate stops")
    life.act("ada", "waive", gate=TIGHT["name"], code="limit-too-tight", reason=REASON, days="2", password=PASSWORD)
    life.holds("CANDIDATE with a waiver")


def test_on_board_the_pages_offer_what_the_server_accepts(life):
    life.act("ada", "submit", reason=REASON)
    life.sign("alan", "APPROVE")
    life.holds("APPROVED")
    life.act("olga", "promote", reason=REASON, password=PASSWORD)
    life.holds("BASELINE")
    for state in ("SENT", "LOADED", "VERIFIED", "ACTIVE"):
        life.record(state)
        life.holds(state, "olga", "ada")


def test_after_a_mismatch_the_pages_offer_what_the_server_accepts(life):
    life.promoted()
    life.record("SENT", "LOADED", "MISMATCH")
    life.holds("MISMATCH by statement", "olga")
    life.record("SENT", "LOADED")
    dump = bytes(len(table(life.site, life.set_id)))
    visitor, version = life.people["olga"], life._version()
    data = {"csrf_token": visitor.csrf_token, "source": "TM 4711", "version": version}
    files = {"file": ("dump.bin", dump, "application/octet-stream")}
    assert visitor.send("POST", f"{life.place}/uplink/read-back", data=data, files=files).status_code == 303
    life.holds("MISMATCH by a dump", "olga", "alan")
    life.record("UNKNOWN")
    life.holds("UNKNOWN after a dump", "olga")


def test_a_former_baseline_that_was_sent_is_offered_what_the_server_accepts(life):
    former = Life.__new__(Life)
    former.__dict__ |= life.__dict__ | {"set_id": 1}
    former.record("SENT", "LOADED", "VERIFIED")
    life.promoted()
    former.holds("SUPERSEDED and VERIFIED", "olga", "both")
    former.record("UNKNOWN")
    former.holds("SUPERSEDED and UNKNOWN", "olga")


def test_the_update_of_c_sd_is_offered_from_loading_on_whatever_was_told_of_it(site, results):
    run = site.add_run("batch", state="SUCCEEDED", result={**results["batch"], "alignment": TURNED})
    life = Life(site, run)
    life.promoted()
    life.holds("BASELINE that turns", "olga")
    for state in ("SENT", "LOADED", "VERIFIED", "ACTIVE", "UNKNOWN"):
        life.record(state)
        life.holds(f"{state} that turns", "olga", asked_with_loaded=state == "UNKNOWN")
        if state == "LOADED":
            told = {"onboard_state": state, "source": "Pass 1", "c_sd": "LOADED", "c_sd_said": "TC 7"}
            life.act("olga", "uplink/record", **told)
            life.holds("LOADED with its C_SD", "olga")


def test_an_approval_that_has_expired_offers_no_package(life, monkeypatch):
    life.act("ada", "submit", reason=REASON)
    life.sign("alan", "APPROVE")
    life.holds("APPROVED", "olga", "ada")
    monkeypatch.setattr(staleness, "utc_now", lambda: utc_after(366 * 86400.0))
    life.holds("APPROVED and expired", "olga", "ada")
    assert 'id="package-blocked"' in life.people["olga"].get(f"{life.place}/uplink")


def step_of_run(life, run_id):
    """What the bar of a run's page has: its stations that are next, and the classes of the button that makes a set of the run."""
    page = life.people["ada"].get(f"/runs/{run_id}").partition('id="stations"')[2].partition("</section>")[0]
    (button,) = re.findall(rf'action="/runs/{run_id}/parameter-set".*?<button class="([^"]*)"', page)
    return page.count('aria-current="step"'), set(button.split()), page


def test_a_run_whose_telemetry_is_active_on_board_says_so_and_makes_no_set_the_next_step(site, results, life):
    of_other_data = site.add_run("batch", state="SUCCEEDED", result=results["batch"], telemetry_set_id=2)
    life.promoted()
    life.record("SENT", "LOADED", "VERIFIED")
    assert step_of_run(life, 2)[:2] == (1, {"button-primary", "button-small"})
    life.record("ACTIVE")
    following, button, page = step_of_run(life, 2)
    assert (following, button) == (0, {"button-small"})
    assert "PS-ST16-1-1" in page
    assert step_of_run(life, of_other_data)[:2] == (1, {"button-primary", "button-small"})
    assert "/runs/2/parameter-set" not in life.people["olga"].get("/runs/2")
    assert life.people["ada"].post("/runs/2/parameter-set").status_code == 303
