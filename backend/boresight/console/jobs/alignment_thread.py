"""The alignment thread: computes one alignment after the other outside of transactions; see `console.alignments.service`.

The telemetry of both runs is solved with their results, paired, estimated, judged, and stored. The time of one is bounded by the
frames and stars of its sides; between the steps it also asks whether the server stops or `MOST_S` have passed.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

import orjson

from boresight.calibration.alignment.align import align_sides
from boresight.calibration.alignment.result import Alignment as AlignmentResult
from boresight.calibration.alignment.sides import Side, make_camera, tracker_side
from boresight.calibration.calibration import parse_calibration, to_plain
from boresight.calibration.joint.passes import NamedTelemetry, join_sets
from boresight.calibration.options import CalibrationSettings
from boresight.calibration.parameter_file import read_reliable_parameters
from boresight.calibration.telemetry_pieces import StoredTable, read_whole
from boresight.console.alignments import service
from boresight.console.alignments.service import ClaimedAlignment, ClaimedSide, ComputedAlignment
from boresight.console.alignments.tables import AlignmentSummary
from boresight.console.runs.results import read_result
from boresight.errors import BoresightError, CancelledError, RefusedInputError, UnavailableError
from boresight.platform.blobs.store import BlobStore
from boresight.platform.blobs.working_tables import working_table
from boresight.platform.db.sessions import Engine, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.platform.jobs.periodic_thread import ClaimingWorker, PeriodicThread
from boresight.telemetry.schema import Telemetry
from boresight.telemetry.sensors import parse_sensor
from boresight.verdicts.gates.alignment import judge_alignment

log = logging.getLogger(__name__)

ROUND_S = 2.0
MOST_S = 300.0


def compute(claimed: ClaimedAlignment, sources: ForecastSources, stopping: Callable[[], bool]) -> ComputedAlignment:
    """Compute an alignment and store its JSON with its gate report."""
    begun_s = time.monotonic()

    def look() -> None:
        if stopping():
            raise CancelledError("The server stops.")
        if time.monotonic() - begun_s > MOST_S:
            raise RefusedInputError(
                f"It took longer than {MOST_S:g} s: align runs on shorter sets, or use `boresight align`."
            )

    a = _solve(claimed.a, sources)
    look()
    b = _solve(claimed.b, sources)
    look()
    found = align_sides(a, b, claimed.options)
    report = judge_alignment(found)
    look()
    sha256 = sources.blobs.put(orjson.dumps({**to_plain(found), "gate_report": to_plain(report)}))
    return ComputedAlignment(sha256, report.verdict, _summarise(found))


def _solve(side: ClaimedSide, sources: ForecastSources) -> Side:
    """Solve the exposures of a run's telemetry with its result, whose covariance counts with misfit."""
    run = side.run
    sensor = parse_sensor(run.sensor_document)
    result = parse_calibration(read_result(sources.blobs, side.result_sha256, run.run_id))
    camera = make_camera(sensor, read_reliable_parameters(result, sensor, f"Run {run.run_id}"))
    if (catalogue := sources.catalogue()) is None:
        raise UnavailableError("This server has no star catalogue; check its data folder.")
    settings = CalibrationSettings(match="rematch")
    return tracker_side(_read(side, sources.blobs), sensor, camera, catalogue, settings, sources.catalogue_folder)


def _read(side: ClaimedSide, blobs: BlobStore) -> Telemetry:
    tables = [
        NamedTelemetry(StoredTable(*working_table(blobs, one.table_sha256)), one.name, one.original_sha256)
        for one in side.run.sets
    ]
    return read_whole(join_sets(tables) if len(tables) > 1 else tables[0].telemetry)


def _summarise(found: AlignmentResult) -> AlignmentSummary:
    return AlignmentSummary(
        sentence=found.sentence,
        pairs=found.pairs,
        pairs_used=found.pairs_used,
        reference_utc=found.reference_utc,
        quaternion=found.quaternion,
        sigma_arcsec=found.sigma_with_misfit_arcsec,
        load_quaternion=found.to_load.quaternion,
        load_sigma_arcsec=found.to_load.sigma_arcsec,
    )


class AlignmentThread(ClaimingWorker[ClaimedAlignment]):
    """The alignments of one server; several servers may share a database."""

    patience_s = 10.0

    def __init__(self, database: Engine, sources: ForecastSources, tell: Callable[[], None]) -> None:
        super().__init__(database, service, tell)
        self._sources = sources
        self._thread = PeriodicThread("alignments", [self.work], lambda: ROUND_S)

    def work(self) -> None:
        """Compute every alignment that waits."""
        while not self._thread.closing and self.take_next(self._compute):
            pass

    def _compute(self, claimed: ClaimedAlignment) -> None:
        """Compute one and write how it ended, whatever happens."""
        try:
            made = compute(claimed, self._sources, lambda: self._thread.closing)
        except CancelledError:
            self._put_back(claimed)
            return
        except BoresightError as error:
            self._fail(claimed, str(error))
            return
        except Exception as error:
            log.exception("Alignment %d failed", claimed.alignment_id)
            self._fail(claimed, f"The computation failed, {type(error).__name__}: {error}")
            return
        with open_writing(self._database) as session:
            service.finish(session, self._sources.blobs, claimed, made)

    def _fail(self, claimed: ClaimedAlignment, reason: str) -> None:
        with open_writing(self._database) as session:
            service.fail(session, claimed, reason)
