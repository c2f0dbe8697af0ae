"""How a file that came by itself is taken in: read and checked outside transactions, received or refused in one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from boresight.console.ingest import service
from boresight.console.ingest.folder import TakenFile
from boresight.console.ingest.service import SentFile
from boresight.console.ingest.tables import IngestDecision, IngestPolicy
from boresight.console.telemetry.service import ImageUpload
from boresight.errors import BoresightError
from boresight.platform.actors import INGEST
from boresight.platform.db.sessions import Engine, Session, open_reading, open_writing
from boresight.platform.jobs.forecasts import ForecastSources
from boresight.settings import Settings


def write_nothing(_: Session) -> None:
    """Write nothing beside a decision."""


@dataclass(frozen=True)
class Intake:
    """The intake of one server; `beside` is written in the transaction of a decision."""

    database: Engine
    sources: ForecastSources
    settings: Settings

    def receive(
        self, policy: IngestPolicy, taken: TakenFile, sent: SentFile, beside: Callable[[Session], None] = write_nothing
    ) -> tuple[IngestDecision, bool]:
        """Read, check and receive a file; return its decision, and whether that is one on the same bytes before."""
        with open_reading(self.database) as session:
            checked = service.read_intake(session, policy.sensor_id)
            known = service.find_earlier(session, policy.sensor_id, taken.sha256)
        if known is not None:
            with open_writing(self.database) as session:
                beside(session)
            return known, True
        images = ImageUpload((), self.settings.image_limits, self.settings.image_seconds)
        limits = self.settings.telemetry_limits
        with (
            service.hold_intake(checked, self.sources, taken.path, taken.name, limits, images) as prepared,
            open_writing(self.database) as session,
        ):
            row = service.receive(session, INGEST, self.sources.blobs, policy.id, prepared, sent)
            beside(session)
        return row, False

    def refuse(
        self,
        policy: IngestPolicy,
        sent: SentFile,
        error: BoresightError,
        beside: Callable[[Session], None] = write_nothing,
    ) -> IngestDecision:
        """Put on record that a file was refused, and why."""
        with open_writing(self.database) as session:
            row = service.refuse(session, INGEST, policy.id, sent, str(error), service.find_code(error))
            beside(session)
        return row
