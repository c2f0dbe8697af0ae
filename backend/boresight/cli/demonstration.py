"""The demonstration: six simulated star trackers with telemetry and runs, one person for every role, and what they did.

`create_demonstration` makes what depends on nothing. `continue_demonstration` goes on where a run has ended, by the services that
pages use and as the people of the demonstration, so that every request, signature, record and alarm is one that the console made:

======  ==========================================================================================================
ST16-1  a filter that runs on for ten minutes, as ST16-5's; both sets are of `WATCHED_FRAMES` frames
ST16-2  a parameter set that waits for approval
ST16-3  a set that was approved, promoted, exported and sent, and of which nothing was read back yet
ST16-4  a year of passes, one a fortnight, while the focal length shortens; the baseline is of the first: a drift alarm
        a policy for new telemetry, as ST16-3: a new pass of ST16-3 asks nothing, and one of ST16-4 a person
ST16-6  a run that failed, for its telemetry has no times
======  ==========================================================================================================
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from boresight.cameras import CAMERA_MODELS
from boresight.console.access import passwords, users
from boresight.console.approvals import gates, review
from boresight.console.approvals import queries as approval_rows
from boresight.console.approvals import service as approvals
from boresight.console.fleet import queries as sensor_queries
from boresight.console.fleet import service as sensors
from boresight.console.fleet.tables import Sensor as SensorRow
from boresight.console.ingest import policies
from boresight.console.ingest import queries as ingest_rows
from boresight.console.ingest import service as ingest
from boresight.console.parameter_sets import service as parameter_sets
from boresight.console.parameter_sets.tables import ParameterSet
from boresight.console.runs import service as runs
from boresight.console.runs.tables import RUN_STATES, TERMINAL_RUN_STATES, Run
from boresight.console.telemetry import queries as set_rows
from boresight.console.telemetry import service as telemetry_sets
from boresight.console.uplinks import packages, table_definitions
from boresight.console.uplinks import service as uplinks
from boresight.disks import compute_digest
from boresight.errors import BoresightError, NotFoundError
from boresight.platform.actors import COMMAND_LINE, POLICY, Actor, Policy
from boresight.platform.audit.signing import SigningKey
from boresight.platform.blobs.store import BlobStore
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from boresight.simulation.scenes import Scenario, calibration_scenario, simulate, validation_scenario
from boresight.simulation.sensors import SENSOR_NUMBERS, st16_sensor, st16_truth
from boresight.sky.catalogue import Catalogue
from boresight.telemetry.sensors import parse_sensor, sensor_document
from boresight.telemetry.writing import write_parquet
from boresight.uplink.table_definition import plain_definition

WATCHED_NUMBERS, WATCHED_FRAMES, WATCHED_FRAMES_PER_S = (1, 5), 600, 1.0
WAITING_NUMBER, SENT_NUMBER, DRIFTING_NUMBER, FAILED_NUMBER = 2, 3, 4, 6
PASSES, PASS_FRAMES, DAYS_APART, DRIFT_M_PER_DAY = 26, 40, 14, -3.5e-8
FAILED_FRAMES = 60
BATCH, FILTER = {"method": "batch"}, {"method": "sqrf", "variant": "no-q"}
WATCHED_FILTER = FILTER | {"replay_frames_per_s": WATCHED_FRAMES_PER_S}
MOST_DAYS = 20_000.0  # the simulated passes are of a fixed date
LIVE = ("QUEUED", "RUNNING", "CANCELLING")
ACCEPTED = "Accepted in the demonstration: the camera is simulated, and its truth is known."


@dataclass(frozen=True)
class LogIn:
    """A person of the demonstration, with the password that is printed for the visitor."""

    name: str
    printed_name: str
    password: str
    roles: tuple[str, ...]


LOG_INS = tuple(
    LogIn(role, printed_name, f"{role}-of-the-fleet", (role,))
    for role, printed_name in (
        ("analyst", "Ada Analyst"),
        ("approver", "Alan Approver"),
        ("operator", "Olga Operator"),
        ("administrator", "Adele Administrator"),
        ("viewer", "Victor Viewer"),
    )
)


def create_demonstration(
    engine: Engine, blobs: BlobStore, catalogue: Catalogue, report: Callable[[str], None], watched: int = 2
) -> list[LogIn]:
    """Fill a store with the demonstration, or with the missing parts of it; `watched` filters run on for ten minutes."""
    started_s = time.perf_counter()
    fleet = _Fleet(engine, blobs, catalogue, _make_people(engine))
    report(f"{len(LOG_INS)} people can log in.")
    for number in SENSOR_NUMBERS:
        fleet.register(number)
    report(f"{len(SENSOR_NUMBERS)} simulated star trackers are registered.")
    for number in SENSOR_NUMBERS:
        fleet.add_sets(number)
        is_new = fleet.launch(number, "Batch", BATCH, validation="validation")
        report(f"{st16_sensor(number).name}: telemetry stored; batch run {_say_whether_new(is_new)}.")
    label = "Square-root filter, fed as frames come down"
    new = [
        fleet.launch(number, label, WATCHED_FILTER, validation="validation", unless=LIVE)
        for number in WATCHED_NUMBERS[:watched]
    ]
    fleet.add_set(calibration_scenario(FAILED_NUMBER, FAILED_FRAMES), "without-times", timeless=True)
    fleet.launch(FAILED_NUMBER, "Downlinked without times", BATCH, "without-times")
    first, validation = _name_pass(0), f"{_name_pass(0)}-validation"
    fleet.add_set(_make_pass(0, calibration_scenario(DRIFTING_NUMBER)), first)
    fleet.add_set(_make_pass(0, validation_scenario(DRIFTING_NUMBER)), validation, "validation")
    fleet.launch(DRIFTING_NUMBER, f"Pass 1 of {PASSES}", BATCH, first, validation)
    new += [fleet.launch(number, "Square-root filter", FILTER, validation="validation") for number in SENSOR_NUMBERS]
    of_filters = _say_whether_new(any(new))
    report(f"Filter runs {of_filters}; the demonstration is ready after {time.perf_counter() - started_s:.1f} s.")
    return list(LOG_INS)


def continue_demonstration(
    engine: Engine,
    blobs: BlobStore,
    catalogue: Catalogue,
    report: Callable[[str], None],
    policy: Policy = POLICY,
    key: SigningKey | None = None,
) -> Iterator[None]:
    """Have the people of the demonstration go on with what has ended; yields each time that it waits for runs."""
    fleet = _Fleet(engine, blobs, catalogue, _make_people(engine), policy, key)
    steps = [fleet.ask_for_approval(), fleet.send_half_way(), fleet.fly_a_year()]
    while steps:
        for step in list(steps):
            try:
                said = next(step, None)
            except BoresightError as refusal:  # such as of a visitor who was there first
                steps.remove(step)
                said = f"A part of the demonstration was skipped: {refusal}"
            if said is None:
                steps.remove(step)
            elif said:
                report(said)
        yield


def _say_whether_new(is_new: bool) -> str:
    """Say whether runs were queued or existed before."""
    return "queued" if is_new else "already in the store"


def _make_people(engine: Engine) -> Actor:
    """Create the missing people of the demonstration, and return the analyst, who acts from then on."""
    with open_reading(engine) as session:
        missing = [person for person in LOG_INS if _user_id(session, person.name) is None]
    for person in missing:
        password = passwords.prepare_unjudged(person.password)  # they are printed on the screen anyway
        with open_writing(engine) as session:
            if _user_id(session, person.name) is None:  # another server may have been faster
                users.create_user(
                    session,
                    COMMAND_LINE,
                    name=person.name,
                    printed_name=person.printed_name,
                    password=password,
                    roles=person.roles,
                )
    analyst = LOG_INS[0]
    with open_reading(engine) as session:
        user_id = _user_id(session, analyst.name)
    return Actor(user_id, analyst.name, analyst.printed_name, frozenset(analyst.roles), COMMAND_LINE.credential)


def _user_id(session: Session, name: str) -> int | None:
    """Return the id of the person with a log-in name."""
    return next((user.id for user in users.list_users(session) if user.name == name), None)


@dataclass(frozen=True)
class _Fleet:
    """Fills the store: each act by the person whose role it takes, each missing item in one transaction."""

    engine: Engine
    blobs: BlobStore
    catalogue: Catalogue
    analyst: Actor
    policy: Policy = POLICY
    key: SigningKey | None = None

    def register(self, number: int) -> None:
        """Register a simulated sensor that is missing."""
        sensor = st16_sensor(number)
        names = CAMERA_MODELS[sensor.camera_model].parameter_names
        # A truth that changes is none: beside one fixed in time, every honest estimate of another pass would be off.
        truth = None if number == DRIFTING_NUMBER else dict(zip(names, st16_truth(number).tolist(), strict=True))
        parse_sensor(sensor_document(sensor))  # the first of a camera compiles, for which no other writer should wait
        with open_writing(self.engine) as session:
            if sensor_queries.find_sensor(session, sensor.name) is None:
                document = sensor_document(sensor)
                sensor_id = sensors.register_sensor(session, self.analyst, document, simulated=True, truth=truth).id
                table = plain_definition(sensor.camera_model)
                reason = "Definition of the simulated flight software."
                table_definitions.set_definition(session, self.analyst, sensor_id, table, reason, 0)

    def add_sets(self, number: int) -> None:
        """Add the calibration and the validation set of a sensor."""
        frames = {"frames": WATCHED_FRAMES} if number in WATCHED_NUMBERS else {}
        self.add_set(calibration_scenario(number, **frames), "calibration")
        self.add_set(validation_scenario(number), "validation", "validation")

    def add_set(self, scenario: Scenario, name: str, purpose: str = "calibration", *, timeless: bool = False) -> None:
        """Simulate a telemetry set and upload it as a Parquet file, unless it is there or was archived."""
        with open_reading(self.engine) as session:
            sensor = _get_sensor(session, scenario.sensor.name)
            file_name = f"{sensor.name}-{name}.parquet"
            if set_rows.find_set_named(session, sensor.id, file_name) is not None:
                return
        telemetry = simulate(scenario, np.random.default_rng(scenario.seed), self.catalogue)
        with tempfile.TemporaryDirectory(prefix="boresight-demo-") as folder:
            path = Path(folder) / file_name
            write_parquet(replace(telemetry, time_utc=None) if timeless else telemetry, path)
            with (
                telemetry_sets.hold_prepared(sensor.document, self.catalogue, path, file_name) as prepared,
                open_writing(self.engine) as session,
            ):
                telemetry_sets.store_prepared(session, self.analyst, self.blobs, sensor.id, prepared, purpose)

    def launch(
        self,
        number: int,
        label: str,
        settings: Mapping[str, Any],
        name: str = "calibration",
        validation: str | None = None,
        *,
        unless: Sequence[str] = RUN_STATES,
    ) -> bool:
        """Queue a run of a set, unless that has one of the method in some states; return whether it was queued."""
        with open_writing(self.engine) as session:
            sensor = _get_sensor(session, st16_sensor(number).name)
            known = [
                None if one is None else set_rows.find_set_named(session, sensor.id, f"{sensor.name}-{one}.parquet")
                for one in (name, validation)
            ]
            used, validated = (row if row and row.archived_utc is None else None for row in known)
            if used is None or runs.list_runs(
                session, telemetry_set_id=used.id, method=settings["method"], state=unless, limit=1
            ):
                return False
            validation_id = None if validated is None else validated.id
            runs.launch(
                session, self.analyst, sensor.id, used.id, settings, validation_set_id=validation_id, label=label
            )
            return True

    def ask_for_approval(self) -> Iterator[str]:
        """Submit a set, which waits for an approver from then on."""
        row = yield from self._submit(WAITING_NUMBER, "Lower validation RMS than the ground calibration.")
        if row is not None:
            yield f"{row.name} waits for the approver."

    def send_half_way(self) -> Iterator[str]:
        """Submit, sign, promote, export and send a set; nothing is read back."""
        row = yield from self._submit(SENT_NUMBER, "Recalibrated after the first orbits.")
        if row is None:
            return
        self._sign_and_promote(row)
        with open_reading(self.engine) as session:
            row = session.get_known(ParameterSet, row.id)
        if (row.ground_state, row.onboard_state) == ("BASELINE", "NOT SENT"):
            operator, _ = self._log_in("operator")
            with open_reading(self.engine) as session:
                made = packages.prepare(session, operator, self.blobs, row.id, policy=self.policy, key=self.key)
            with open_writing(self.engine) as session:
                package = packages.build(session, operator, self.blobs, row.id, made, policy=self.policy)
                uplinks.record(session, operator, row.id, "SENT", "Simulated pass 1.", package_id=package.id)
        yield f"{row.name} is sent; nothing was read back yet."
        yield from self._judge_new_pass(SENT_NUMBER, "calibration")

    def fly_a_year(self) -> Iterator[str]:
        """Make the first pass's set the baseline, then calibrate the passes that came after it."""
        row = yield from self._submit(DRIFTING_NUMBER, "The first calibration on orbit.", _name_pass(0))
        if row is None:
            return
        self._sign_and_promote(row)
        for k in range(1, PASSES):
            self.add_set(_make_pass(k, calibration_scenario(DRIFTING_NUMBER, PASS_FRAMES)), _name_pass(k))
            yield ""
        for k in range(1, PASSES):  # together: the alarm's sentence changes with each group that ends
            self.launch(DRIFTING_NUMBER, f"Pass {k + 1} of {PASSES}", BATCH, _name_pass(k))
        yield f"{PASSES} passes of {row.document['sensor']} stored, covering one year."
        yield from self._judge_new_pass(DRIFTING_NUMBER, _name_pass(PASSES - 1))

    def _judge_new_pass(self, number: int, name: str) -> Iterator[str]:
        """Put a policy into force once the run of a set has ended, and take a new pass in."""
        while (run := self._find_batch_run(number, name)) is not None and run.state in LIVE:
            yield ""
        policy = self._enable_policy(number)
        if policy is not None:
            self._take_in(number, policy)
            yield f"A new pass of {st16_sensor(number).name} is judged by its policy."

    def _enable_policy(self, number: int) -> int | None:
        """Draft, rehearse and enable a policy for new telemetry; None where the sensor has one already."""
        with open_reading(self.engine) as session:
            sensor_id = _get_sensor(session, st16_sensor(number).name).id
            if ingest_rows.list_policies(session, sensor_id):
                return None
        administrator, _ = self._log_in("administrator")
        rules = {"oldest_days": MOST_DAYS, "preset": "first-calibration"}
        with open_writing(self.engine) as session:
            drafted = policies.draft(session, self.analyst, sensor_id, rules, "A pass every fortnight.")
            policy_id, version = drafted.id, drafted.version
        with open_reading(self.engine) as session:  # it takes seconds, and somebody may want to log in
            found = policies.compute_rehearsal(session, policy_id)
        with open_writing(self.engine) as session:
            row = policies.record_rehearsal(session, self.analyst, policy_id, found, version)
            return policies.enable(session, administrator, row.id, row.version).id

    def _take_in(self, number: int, policy_id: int) -> None:
        """Send a pass of the day after the sensor's last one, as a program would over REST."""
        scenario = _make_pass(PASSES, calibration_scenario(number, PASS_FRAMES))
        drifted = scenario if number == DRIFTING_NUMBER else calibration_scenario(number, PASS_FRAMES)
        orbit = replace(drifted.orbit, start_utc=scenario.orbit.start_utc + np.timedelta64(1, "D"))
        made = replace(drifted, orbit=orbit, seed=scenario.seed + 1)
        telemetry = simulate(made, np.random.default_rng(made.seed), self.catalogue)
        with open_reading(self.engine) as session:
            document = session.get_known(SensorRow, _get_sensor(session, scenario.sensor.name).id).document
        with tempfile.TemporaryDirectory(prefix="boresight-demo-") as folder:
            path = Path(folder) / f"{scenario.sensor.name}-new-pass.parquet"
            write_parquet(telemetry, path)
            sent = ingest.SentFile("REST", path.name, compute_digest(path), path.stat().st_size)
            with (
                telemetry_sets.hold_prepared(document, self.catalogue, path, path.name) as prepared,
                open_writing(self.engine) as session,
            ):
                ingest.receive(session, self.analyst, self.blobs, policy_id, prepared, sent)

    def _submit(self, number: int, reason: str, name: str = "calibration") -> Generator[str, None, ParameterSet | None]:
        """Wait for the batch run of a set and submit what it found, unless that was done; None where it found nothing."""
        while (run := self._find_batch_run(number, name)) is not None and run.state not in TERMINAL_RUN_STATES:
            yield ""
        if run is None or run.state != "SUCCEEDED":
            return None
        with open_writing(self.engine) as session:
            row = parameter_sets.create_from_run(session, self.analyst, self.blobs, run.id)
        if row.ground_state == "CANDIDATE":
            with open_reading(self.engine) as session:
                assessment = gates.measure(session, self.blobs, self.catalogue, row.id)
            with open_writing(self.engine) as session:
                approvals.submit(
                    session, self.analyst, self.blobs, row.id, reason, row.version, assessment, policy=self.policy
                )
        return row

    def _find_batch_run(self, number: int, name: str) -> Run | None:
        """Return the first batch run of a set."""
        with open_reading(self.engine) as session:
            sensor = _get_sensor(session, st16_sensor(number).name)
            used = set_rows.find_set_named(session, sensor.id, f"{sensor.name}-{name}.parquet")
            found = [] if used is None else runs.list_runs(session, telemetry_set_id=used.id, method="batch")
            return found[-1] if found else None

    def _sign_and_promote(self, row: ParameterSet) -> None:
        """Approve the open request for a set as the approver, and promote it as the operator, unless that was done."""
        with open_reading(self.engine) as session:
            state = session.get_known(ParameterSet, row.id).ground_state
        if state == "SUBMITTED":
            approver, proof = self._log_in("approver")
            with open_writing(self.engine) as session:
                request = approval_rows.find_latest_approval(session, row.id, "OPEN")
                points = [] if request is None else review.list_points(session, request)
                accepted = [review.Acknowledgement(point.kind, point.name, ACCEPTED) for point in points]
                decided = approvals.Decision("APPROVE", "I approve this set for baseline.", "", accepted)
                if request is not None:
                    approvals.sign(session, approver, request.id, decided, proof, request.version, policy=self.policy)
        if state in {"SUBMITTED", "APPROVED"}:
            operator, proof = self._log_in("operator")
            with open_writing(self.engine) as session:
                version = session.get_known(ParameterSet, row.id).version
                approvals.promote(session, operator, row.id, version, "Signed.", proof, policy=self.policy)

    def _log_in(self, name: str) -> tuple[Actor, passwords.PasswordProof]:
        """Return a person of the demonstration who gave the printed password, with its proof."""
        password = next(person.password for person in LOG_INS if person.name == name)
        with open_reading(self.engine) as session:
            stored = passwords.read_stored_under(session, name)
        proof = passwords.check(stored, password)
        with open_reading(self.engine) as session:
            return users.authenticate(session, proof), proof


def _get_sensor(session: Session, name: str) -> SensorRow:
    """Return a sensor that was registered before."""
    sensor = sensor_queries.find_sensor(session, name)
    if sensor is None:
        raise NotFoundError(f"{name} is not registered; start the demonstration again.")
    return sensor


def _make_pass(k: int, scenario: Scenario) -> Scenario:
    """Return a scenario as pass k of a year that ends with it: the more days are left, the longer the focal length."""
    names, truth, days_left = (
        CAMERA_MODELS[scenario.sensor.camera_model].parameter_names,
        scenario.truth.copy(),
        _days_left(k),
    )
    truth[names.index("f_m")] -= DRIFT_M_PER_DAY * days_left
    orbit = replace(scenario.orbit, start_utc=scenario.orbit.start_utc - np.timedelta64(days_left, "D"))
    return replace(scenario, truth=truth, orbit=orbit, seed=1000 * scenario.seed + k)


def _days_left(k: int) -> int:
    return DAYS_APART * (PASSES - k)


def _name_pass(k: int) -> str:
    day = calibration_scenario(DRIFTING_NUMBER).orbit.start_utc - np.timedelta64(_days_left(k), "D")
    return f"pass-{day.astype('datetime64[D]')}"
