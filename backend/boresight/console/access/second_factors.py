"""Second factors: codes of an authenticator app (TOTP, RFC 6238), security keys (WebAuthn), and recovery codes.

With secret K and time t [s], the code of step T is that of HOTP (RFC 4226)::

    T = floor(t / 30),   accepted: T' in {T - 1, T, T + 1} with T' > the newest step that was taken

so no code is taken twice, and one that was seen is of no use. Of 10^6 codes three fit at a time. A recovery code has 118
random bits and is kept as SHA-256, which is enough for what cannot be guessed. Secrets of apps are encrypted with the key of
`SecretBox`. Every use is made inside the writing transaction of what it allows, of which there is one at a time: two
requests never use the same code.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import pyotp

from boresight.console.access import queries as rows
from boresight.console.access.tables import FactorChallenge, RecoveryCode, SecondFactor, User
from boresight.console.access.webauthn_ceremonies import (
    RelyingParty,
    check_assertion,
    check_registration,
    make_creation_options,
    make_request_options,
    new_challenge,
    read_assertion,
)
from boresight.errors import ConflictError, ForbiddenError, NotFoundError, RefusedInputError, SecondFactorError
from boresight.platform.actors import SYSTEM, Actor, refuse_key, require_person, require_role
from boresight.platform.audit import log as audit
from boresight.platform.audit.security_log import note, tell
from boresight.platform.db.secret_box import SecretBox
from boresight.platform.db.sessions import Session, keep_despite_refusal, utc_after, utc_now
from boresight.platform.web.text_validation import refuse_control_characters

OFF, OPTIONAL, REQUIRED = "off", "optional", "required-to-sign"
MODES = (OFF, OPTIONAL, REQUIRED)
REQUIRED_OF = frozenset({"approver", "administrator"})

STEP_S, WINDOW, DIGITS = 30, 1, 6
WAITS_S = 600.0  # how long a challenge can be answered
FORGET_S = 3600.0
MOST_FAILURES = 5  # wrong answers to one challenge
MOST_CHALLENGES = 60  # of one person in `WAITS_S`
MOST_FACTORS = 10
LONGEST_LABEL = 60
CODES, CODE_LETTERS, CODE_GROUP = 10, 24, 4
LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"  # none that looks like another
LONGEST_CODE = 40

WRONG_CODE = "That code is wrong, too old or was used already; wait for the next one and type it."
GIVE_CODE = "Give your second factor too: the code of your authenticator app, a recovery code, or your security key."
UNREADABLE = (
    "The secret of this authenticator app cannot be decrypted with this server's key; use a recovery code, or ask an administrator "
    "to reset your second factor."
)


@dataclass(frozen=True)
class FactorRules:
    """Of whom an installation asks a second factor, and what opens the stored secrets."""

    mode: str
    box: SecretBox

    @property
    def are_on(self) -> bool:
        """Whether anybody is asked for one."""
        return self.mode != OFF

    def demand(self, roles: Collection[str]) -> bool:
        """Whether somebody with these roles must have one."""
        return self.mode == REQUIRED and not REQUIRED_OF.isdisjoint(roles)


@dataclass(frozen=True)
class GivenFactor:
    """What was given as a second factor, on which site, and whether a typed code was right when it was looked at."""

    code: str = field(default="", repr=False)
    site: RelyingParty | None = None
    rules: FactorRules | None = None
    fits: bool = True


NO_FACTOR = GivenFactor()


def needs_second_factor(session: Session, user_id: int, rules: FactorRules | None) -> bool:
    """Whether a person has a second factor and is asked for it."""
    return rules is not None and rules.are_on and bool(rows.list_factors(session, user_id))


def list_factors(session: Session, actor: Actor) -> Sequence[SecondFactor]:
    """Return the acting person's second factors."""
    return rows.list_factors(session, require_person(actor, "see second factors"))


def count_recovery_codes(session: Session, actor: Actor) -> int:
    """Return how many recovery codes the acting person has left."""
    return len(rows.list_recovery_codes(session, require_person(actor, "see recovery codes")))


def fits(session: Session, user_id: int, code: str, rules: FactorRules) -> bool:
    """Whether a typed code would be taken now; the answer of a security key is judged where it is used."""
    typed = _plain(code)
    if code.lstrip().startswith("{"):
        return True
    if _is_of_app(typed):
        return any(_find_step(one, typed, rules) for one in rows.list_factors(session, user_id))
    return any(hmac.compare_digest(one.code_hash, _hash(typed)) for one in rows.list_recovery_codes(session, user_id))


def _plain(code: str) -> str:
    """Return a typed code without what people put between its letters."""
    return "".join(letter for letter in code[:LONGEST_CODE].lower() if letter.isascii() and letter.isalnum())


def _hash(code: str) -> str:
    return hashlib.sha256(code.encode()).hexdigest()


def _is_of_app(typed: str) -> bool:
    """Whether a code has the form of an authenticator app's; a recovery code is longer."""
    return typed.isdecimal() and len(typed) == DIGITS


def _find_step(factor: SecondFactor, typed: str, rules: FactorRules) -> int | None:
    """Return the time step that a code is valid for, later than any used before; None where it is valid for none."""
    if factor.kind != "totp" or (secret := rules.box.open(factor.secret)) is None:
        return None
    return _match(secret, typed, factor.last_step)


def _match(secret: str, typed: str, last_step: int) -> int | None:
    app, now = pyotp.TOTP(secret, digits=DIGITS, interval=STEP_S), int(time.time()) // STEP_S
    found = [
        step for step in range(now - WINDOW, now + WINDOW + 1) if hmac.compare_digest(app.generate_otp(step), typed)
    ]
    return next((step for step in found if step > last_step), None)


def use(
    session: Session,
    actor: Actor,
    user: User,
    given: GivenFactor,
    purpose: str,
    waiting: FactorChallenge | None = None,
) -> str:
    """Use what was given as a person's second factor, once; returns its kind. `waiting` is the log-in that it is given for."""
    rules = given.rules
    if rules is None:
        raise ValueError("Expected the rules of the installation / Received none")
    if not given.code.strip():
        raise SecondFactorError(GIVE_CODE)
    is_key = given.code.lstrip().startswith("{")
    try:
        kind = (_use_security_key if is_key else _use_code)(session, actor, user, given, waiting)
    except SecondFactorError as error:
        told = {"user": user.name, "kind": "webauthn" if is_key else "code", "purpose": purpose}
        tell("authn_factor_fail", "failure", actor, **told, reason=str(error))
        raise
    note(session, "authn_factor_used", actor, user=user.name, kind=kind, purpose=purpose)
    return kind


def _why_not(session: Session, user: User, typed: str, rules: FactorRules) -> str:
    """Return why a code was not taken."""
    apps = [one for one in rows.list_factors(session, user.id) if one.kind == "totp"]
    lost = apps and _is_of_app(typed) and all(rules.box.open(one.secret) is None for one in apps)
    return UNREADABLE if lost else WRONG_CODE


def _use_code(
    session: Session, actor: Actor, user: User, given: GivenFactor, _waiting: FactorChallenge | None = None
) -> str:
    """Take the code of an authenticator app, or a recovery code."""
    rules, typed = given.rules, _plain(given.code)
    if rules is None or not given.fits:
        raise SecondFactorError(WRONG_CODE if rules is None else _why_not(session, user, typed, rules))
    if _is_of_app(typed):
        for factor in rows.list_factors(session, user.id):
            if (step := _find_step(factor, typed, rules)) is not None:
                factor.last_step, factor.last_used_utc = step, utc_now()
                return "totp"
        raise SecondFactorError(_why_not(session, user, typed, rules))
    codes = rows.list_recovery_codes(session, user.id)
    code = next((one for one in codes if hmac.compare_digest(one.code_hash, _hash(typed))), None)
    if code is None:
        raise SecondFactorError(WRONG_CODE)
    code.ended_utc, code.ended_because = utc_now(), "used"
    left = len(codes) - 1
    audit.append(session, actor, "used a recovery code of", f"users/{user.id}", None, {"left": left})
    note(session, "authn_recovery_code_used", actor, user=user.name, left=left)
    return "recovery"


def _use_security_key(
    session: Session, actor: Actor, user: User, given: GivenFactor, waiting: FactorChallenge | None
) -> str:
    """Take the answer of a security key to a challenge that was made for this log-in, or under this one for a signature."""
    assertion = read_assertion(given.code)
    challenge = waiting
    if challenge is None and actor.session_id is not None:
        challenge = rows.find_challenge(session, user.id, actor.session_id, assertion.challenge)
        if challenge is not None and challenge.purpose != "sign":
            challenge = None
    if challenge is None or given.site is None:
        raise SecondFactorError("The security key response does not match a request of this page; use the key again.")
    if waiting is None:
        _take(challenge)
    factor = rows.find_credential(session, assertion.credential_id)
    ours = factor is not None and factor.user_id == user.id and factor.ended_utc is None and factor.kind == "webauthn"
    if factor is None or not ours or factor.rp_id != given.site.rp_id:
        raise SecondFactorError("This security key is not enrolled for you; use another one or a recovery code.")
    count = check_assertion(assertion, challenge.challenge, given.site, factor.secret, factor.sign_count)
    factor.sign_count, factor.last_used_utc = count, utc_now()
    return "webauthn"


def _take(challenge: FactorChallenge) -> None:
    """Take a challenge, which nobody can answer again."""
    if challenge.ended_utc is not None or challenge.created_utc < utc_after(-WAITS_S):
        raise SecondFactorError("This took too long or was answered already; begin it again.")
    challenge.ended_utc = utc_now()


def make_signing_challenge(session: Session, actor: Actor, rules: FactorRules, site: RelyingParty) -> dict[str, Any]:
    """Make the question that a security key answers for one signature under this log-in."""
    user_id = require_person(actor, "use a security key")
    known = rows.list_factors(session, user_id)
    challenge = new_challenge()
    options = make_request_options(known, challenge, site) if rules.are_on else None
    if options is None:
        raise ConflictError("You have no security key for this site; type the code of your app, or a recovery code.")
    _put(session, actor, user_id, "sign", challenge)
    return dict(json.loads(options))


def _put(session: Session, actor: Actor, user_id: int, purpose: str, challenge: str) -> FactorChallenge:
    if rows.count_challenges(session, user_id, utc_after(-WAITS_S)) >= MOST_CHALLENGES:
        raise ConflictError(f"Too many attempts ({MOST_CHALLENGES} in {WAITS_S / 60:.0f} min); wait and try again.")
    row = FactorChallenge(
        user_id=user_id, purpose=purpose, session_id=actor.session_id, challenge=challenge, created_utc=utc_now()
    )
    session.put(row)
    return row


# Log-ins that wait for their second factor


def begin_waiting(session: Session, user_id: int, method: str) -> str:
    """Let a log-in whose password was right wait for its second factor; returns the secret for its cookie."""
    token = secrets.token_urlsafe(32)
    if rows.count_challenges(session, user_id, utc_after(-WAITS_S)) >= MOST_CHALLENGES:
        raise ConflictError(f"Too many attempts ({MOST_CHALLENGES} in {WAITS_S / 60:.0f} min); wait and try again.")
    row = FactorChallenge(
        user_id=user_id,
        purpose="log-in",
        token_hash=_hash(token),
        method=method,
        challenge=new_challenge(),
        created_utc=utc_now(),
    )
    session.put(row)
    return token


def find_waiting(session: Session, token: str) -> FactorChallenge:
    """Return the log-in that waits under a cookie."""
    row = rows.find_challenge_by_token(session, _hash(token))
    if row is None or row.ended_utc is not None or row.created_utc < utc_after(-WAITS_S):
        raise SecondFactorError("This log-in waited too long for its second factor, or was refused; log in again.")
    return row


def make_log_in_options(session: Session, waiting: FactorChallenge, site: RelyingParty) -> str | None:
    """Return what a security key is asked for a log-in that waits; None where the person has none for this site."""
    return make_request_options(rows.list_factors(session, waiting.user_id), waiting.challenge, site)


def finish_waiting(
    session: Session, token: str, given: GivenFactor, request_id: str | None = None
) -> tuple[FactorChallenge, str]:
    """Use the second factor of a log-in that waits; after `MOST_FAILURES` wrong ones the password is asked again."""
    row = find_waiting(session, token)
    user = session.get_known(User, row.user_id)
    if user.disabled_utc is not None:
        raise SecondFactorError("This account is disabled; ask an administrator.")
    actor = Actor(user.id, user.name, user.printed_name, frozenset(user.roles), "session", None, request_id)
    with _settling(session, row):
        kind = use(session, actor, user, given, "log-in", row)
    return row, kind


@contextmanager
def _settling(session: Session, row: FactorChallenge) -> Iterator[None]:
    """End a challenge with its right answer, or with the last wrong one that it takes; each is counted though it is refused."""
    try:
        yield
    except SecondFactorError:
        row.failures += 1
        if row.failures >= MOST_FAILURES:
            row.ended_utc = utc_now()
        keep_despite_refusal(session)
        raise
    row.ended_utc = utc_now()


# Enrolment


@dataclass(frozen=True)
class FactorOffer:
    """What a person needs to enrol a second factor: the secret of an app, or the options of a security key."""

    challenge_id: int
    kind: str
    secret: str | None = field(default=None, repr=False)
    uri: str | None = field(default=None, repr=False)
    options: dict[str, Any] | None = None


def offer(session: Session, actor: Actor, kind: str, rules: FactorRules, site: RelyingParty) -> FactorOffer:
    """Begin to enrol a second factor of a person who confirmed who they are (`confirmations.require`)."""
    user = session.get_known(User, require_person(actor, "enrol a second factor"))
    _refuse_off(rules)
    known = rows.list_factors(session, user.id)
    if len(known) >= MOST_FACTORS:
        raise ConflictError(f"You have {len(known)} second factors; remove one first.")
    if kind == "totp":
        secret = pyotp.random_base32()
        row = _put(session, actor, user.id, "totp", rules.box.seal(secret))
        return FactorOffer(row.id, kind, secret, make_uri(secret, user.name, site))
    if kind != "webauthn":
        raise RefusedInputError(f"There is no second factor {kind[:20]!r}; choose totp or webauthn.")
    challenge = new_challenge()
    options = make_creation_options(user, known, challenge, site)
    row = _put(session, actor, user.id, "webauthn", challenge)
    return FactorOffer(row.id, kind, options=dict(json.loads(options)))


def make_uri(secret: str, name: str, site: RelyingParty) -> str:
    """Return the address that an authenticator app reads from a QR code."""
    return pyotp.TOTP(secret, digits=DIGITS, interval=STEP_S).provisioning_uri(
        name=name, issuer_name=f"Boresight {site.rp_id}".strip()
    )


def find_offer(
    session: Session, actor: Actor, challenge_id: int, rules: FactorRules, site: RelyingParty
) -> FactorOffer:
    """Return an enrolment that was begun under this log-in and not finished, to be shown again."""
    user = session.get_known(User, require_person(actor, "enrol a second factor"))
    row = _find_own(session, actor, challenge_id)
    if row.purpose == "totp":
        secret = rules.box.open(row.challenge) or ""
        return FactorOffer(row.id, "totp", secret, make_uri(secret, user.name, site))
    options = make_creation_options(user, rows.list_factors(session, user.id), row.challenge, site)
    return FactorOffer(row.id, "webauthn", options=dict(json.loads(options)))


def _refuse_off(rules: FactorRules) -> None:
    if not rules.are_on:
        raise ConflictError("Second factors are off here; have BORESIGHT_SECOND_FACTOR=optional set on the server.")


def _find_own(session: Session, actor: Actor, challenge_id: int) -> FactorChallenge:
    row = session.get(FactorChallenge, challenge_id)
    own = row is not None and row.user_id == actor.user_id and row.session_id == actor.session_id
    if row is None or not own or row.purpose not in {"totp", "webauthn"}:
        raise NotFoundError("There is no such enrolment under this log-in; begin it again.")
    if row.ended_utc is not None or row.created_utc < utc_after(-WAITS_S):
        raise SecondFactorError("This enrolment took too long or was finished already; begin it again.")
    return row


def enrol(
    session: Session, actor: Actor, challenge_id: int, label: str, answer: str, rules: FactorRules, site: RelyingParty
) -> tuple[SecondFactor, list[str] | None]:
    """Enrol what was begun once it proved to work; with the first one come recovery codes, and every other log-in ends."""
    user = session.get_known(User, require_person(actor, "enrol a second factor"))
    _refuse_off(rules)
    refuse_control_characters(label=label)
    label = label.strip()
    if len(label) > LONGEST_LABEL:
        raise RefusedInputError(f"The name of a second factor has at most {LONGEST_LABEL} letters; shorten it.")
    offered = _find_own(session, actor, challenge_id)
    first = not rows.list_factors(session, user.id)
    with _settling(session, offered):
        factor = _make(session, user, offered, answer, rules, site)
    factor.label = label or {"totp": "Authenticator app", "webauthn": "Security key"}[factor.kind]
    session.put(factor)
    rows.end_open_log_ins(session, user.id, utc_now(), "ended", spare_id=actor.session_id)
    told = {"kind": factor.kind, "label": factor.label}
    audit.append(session, actor, "enrolled", _subject(factor), None, told)
    note(session, "authn_factor_enrolled", actor, user=user.name, kind=factor.kind, factor=factor.id)
    return factor, _make_codes(session, actor, user) if first else None


def _make(
    session: Session, user: User, offered: FactorChallenge, answer: str, rules: FactorRules, site: RelyingParty
) -> SecondFactor:
    if offered.purpose == "totp":
        secret = rules.box.open(offered.challenge)
        step = None if secret is None else _match(secret, _plain(answer), 0)
        if step is None:
            raise SecondFactorError(
                "The code is wrong; check the clock of your device, and type the code it shows now."
            )
        return SecondFactor(
            user_id=user.id, kind="totp", label="", secret=offered.challenge, created_utc=utc_now(), last_step=step
        )
    made = check_registration(answer, offered.challenge, site)
    if rows.find_credential(session, made.credential_id) is not None:
        raise SecondFactorError(
            "This security key is enrolled here already, for you or another person; use another one."
        )
    return SecondFactor(
        user_id=user.id,
        kind="webauthn",
        label="",
        secret=made.public_key,
        credential_id=made.credential_id,
        rp_id=site.rp_id,
        created_utc=utc_now(),
        sign_count=made.sign_count,
    )


def _make_codes(session: Session, actor: Actor, user: User) -> list[str]:
    """Make recovery codes in place of those that are left; returns them, this once."""
    for old in rows.list_recovery_codes(session, user.id):
        old.ended_utc, old.ended_because = utc_now(), "replaced"
    plain = ["".join(secrets.choice(LETTERS) for _ in range(CODE_LETTERS)) for _ in range(CODES)]
    for code in plain:
        session.add(RecoveryCode(user_id=user.id, code_hash=_hash(code), created_utc=utc_now()))
    audit.append(session, actor, "made recovery codes of", f"users/{user.id}", None, {"codes": CODES})
    note(session, "authn_recovery_codes_made", actor, user=user.name)
    return ["-".join(code[at : at + CODE_GROUP] for at in range(0, CODE_LETTERS, CODE_GROUP)) for code in plain]


def renew_recovery_codes(session: Session, actor: Actor) -> list[str]:
    """Make new recovery codes of a person who confirmed who they are; those of before no longer work."""
    user = session.get_known(User, require_person(actor, "have recovery codes made"))
    if not rows.list_factors(session, user.id):
        raise ConflictError("Recovery codes replace a second factor, but you have none enrolled; enrol one first.")
    return _make_codes(session, actor, user)


def remove(session: Session, actor: Actor, factor_id: int, rules: FactorRules) -> SecondFactor:
    """Remove a second factor of a person who confirmed who they are; not the last one of somebody who must have one."""
    user_id = require_person(actor, "remove a second factor")
    known = rows.list_factors(session, user_id)
    factor = next((one for one in known if one.id == factor_id), None)
    if factor is None:
        raise NotFoundError(f"There is no second factor {factor_id} of yours; choose one from the list.")
    if len(known) == 1 and rules.demand(actor.roles):
        raise ConflictError("Your roles need a second factor, and this is your only one; enrol another one first.")
    factor.ended_utc, factor.ended_because = utc_now(), "removed"
    if len(known) == 1:
        _end_codes(session, user_id, "replaced")
    audit.append(
        session, actor, "removed", _subject(factor), {"removed": False}, {"removed": True, "label": factor.label}
    )
    note(session, "authn_factor_removed", actor, user=actor.name, kind=factor.kind, factor=factor.id)
    return factor


def _end_codes(session: Session, user_id: int, because: str) -> None:
    for code in rows.list_recovery_codes(session, user_id):
        code.ended_utc, code.ended_because = utc_now(), because


def reset(session: Session, actor: Actor, user_id: int) -> User:
    """Remove every second factor of another person, who lost theirs, and end their log-ins; administrators only."""
    refuse_key(actor, "reset a second factor")
    require_role(actor, "administrator")
    user = session.get_known(User, user_id)
    if user.id == actor.user_id:
        raise ForbiddenError(
            "Your own second factor is reset by another administrator, or on the command line; ask one."
        )
    known = rows.list_factors(session, user.id)
    if not known:
        raise ConflictError(f"{user.printed_name} has no second factor; there is nothing to reset, check the person.")
    for factor in known:
        factor.ended_utc, factor.ended_because = utc_now(), "reset"
    _end_codes(session, user.id, "reset")
    user.session_epoch += 1
    rows.end_open_log_ins(session, user.id, utc_now(), "ended_by_administrator")
    rows.end_challenges(session, user.id, utc_now())
    audit.append(
        session, actor, "reset the second factor of", f"users/{user.id}", {"factors": len(known)}, {"factors": 0}
    )
    note(session, "authn_factor_reset", actor, user=user.name)
    return user


def list_enrolled_ids(session: Session) -> frozenset[int]:
    """Return who has a second factor, for those who manage people."""
    return rows.list_enrolled_ids(session)


def encrypt_anew(session: Session, box: SecretBox) -> int:
    """Encrypt every readable secret of an authenticator app with the newest key; return how many."""
    count = 0
    for row in rows.list_encrypted_factors(session):
        if row.kind == "totp" and (renewed := box.renew(row.secret)) is not None:
            row.secret, count = renewed, count + 1
            audit.append(session, SYSTEM, "encrypted the secret of", _subject(row))
    return count


def _subject(factor: SecondFactor) -> str:
    return f"second-factors/{factor.id}"
