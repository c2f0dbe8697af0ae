"""What can go wrong, by kind. Every error is one clear sentence that says what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class Fault:
    """One place in an input where something is wrong; `name`: of the field that it is about, where one may be asked for."""

    row: int | None
    column: str | None
    detail: str
    name: str = ""

    def __str__(self) -> str:
        """Join place and detail as `row 12, column row_px: ...`."""
        place = [f"row {self.row}"] * (self.row is not None) + [f"column {self.column}"] * (self.column is not None)
        return f"{', '.join(place)}: {self.detail}" if place else self.detail


class BoresightError(Exception):
    """Any refusal of this package; `code` is its reason in a fixed word for programs, where it has one."""

    def __init__(self, sentence: str = "", *, code: str = "") -> None:
        super().__init__(sentence)
        self.code = code


class RefusedInputError(BoresightError, ValueError):
    """The input cannot be used; the faults say where and what to do."""

    def __init__(self, sentence: str, faults: tuple[Fault, ...] = (), *, code: str = "") -> None:
        super().__init__(sentence, code=code)
        self.faults = faults


class NotFoundError(BoresightError, LookupError):
    """No such thing is stored."""


class ConflictError(BoresightError):
    """The thing is not in a state that allows this; says what state it is in and who changed it."""


class CorruptFileError(ConflictError):
    """A stored file is not what was stored: its bytes do not have the SHA-256 that it is known by."""

    def __init__(self, sentence: str, sha256: str = "", *, code: str = "") -> None:
        super().__init__(sentence, code=code)
        self.sha256 = sha256


class StaleError(BoresightError):
    """The caller saw an older version than the one stored."""


class PreconditionRequiredError(BoresightError):
    """A transition was asked without saying which version was seen."""


class ForbiddenError(BoresightError):
    """The person or key may not do it; says who may."""


class PasswordDueError(ForbiddenError):
    """Somebody else set the person's password; they must set their own before anything else."""


class FactorEnrolmentDueError(ForbiddenError):
    """The person's roles need a second factor and none is enrolled; they must enrol one before anything else."""


class UnauthenticatedError(BoresightError):
    """Nobody is logged in, or the log-in has expired."""


class SecondFactorError(UnauthenticatedError):
    """The second factor is missing, wrong or used already."""


class SingleSignOnError(UnauthenticatedError):
    """The identity provider's answer was refused; `reason` is the word for the security log."""

    def __init__(self, sentence: str, reason: str = "refused") -> None:
        super().__init__(sentence, code=reason)
        self.reason = reason


class SessionEndedError(UnauthenticatedError):
    """The log-in has ended; `because` is the word that the store keeps, the sentence says it to the person."""

    SENTENCES: ClassVar[Mapping[str, str]] = {
        "logged_out": "You logged out; log in again.",
        "ended": "This log-in was ended from the list of your log-ins; log in again.",
        "ended_by_administrator": "An administrator ended this log-in; log in again.",
        "password_changed": "Your password was changed, which ends every log-in; log in with the new one.",
        "roles_changed": "Your roles were changed, which ends every log-in; log in again.",
        "disabled": "This account is disabled; ask an administrator.",
        "idle": "Your log-in was unused for too long and has ended; log in again.",
        "expired": "Your log-in has reached its maximum age and has expired; log in again.",
    }

    def __init__(self, because: str) -> None:
        super().__init__(self.SENTENCES.get(because, "This log-in has ended; log in again."), code=because)
        self.because = because


class TooManyAttemptsError(BoresightError):
    """It was tried too often; may be tried again after `wait_s` whole seconds."""

    def __init__(self, sentence: str, wait_s: int) -> None:
        super().__init__(sentence)
        self.wait_s = wait_s


class OverloadedError(BoresightError):
    """More is asked at once than can be answered soon; may be asked again after `wait_s` whole seconds."""

    def __init__(self, sentence: str, wait_s: int) -> None:
        super().__init__(sentence)
        self.wait_s = wait_s


class UnavailableError(BoresightError):
    """What the work stands on, the database or the object store, does not answer; says which, and may be tried again."""


class StorageError(UnavailableError):
    """A disk is full, cannot be written or is not there; may be tried again after `wait_s` whole seconds."""

    wait_s = 30


class TooLargeError(BoresightError):
    """The upload is over the size limit."""


class CancelledError(BoresightError):
    """The computation was asked to stop and did."""
