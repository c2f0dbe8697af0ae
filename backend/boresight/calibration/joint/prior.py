"""Posterior in, posterior out: what a former calibration knew of the parameters, as a run takes it in and says how much it used.

Which covariance. A prior enters with the covariance that decisions go by, with misfit, widened further where its chi-square,
innovations or the Cramér-Rao bound say so (`result.trend_entry`): what the model did not hold then did not average out. `noise`
takes the covariance of noise alone, under which a prior and further data are exactly the joint problem of both, to
linearisation. Either is then multiplied by `prior_inflation` squared and, for its age of T days, drifts as a random walk:

    P_0 = prior_inflation^2 P + prior_drift_sigma^2 T I          in typical sigmas

Which parameters. A covariance is that of some parameters with the others held where they were, so a prior is taken for exactly the
parameters that it freed, and those it held stay where it held them: the run starts at its state, which is its `initial`.

Counted once. A calibration names its telemetry by SHA-256, and one with a prior that of the prior too. A set that the prior holds
already is left out of a joint run, which equals taking its information out of one of the two, and refused where nothing is left.
The same stars in another file have another SHA-256. Under the covariance of noise alone, data that are independent of a prior
differ from it by chi-square; data that the prior holds do not differ at all. So where that chi-square is smaller than one in
`SAME` would have it by chance, and where the data begin within the times of the prior, it is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from boresight.arrays import FloatArray, parse_times
from boresight.calibration.advice_kinds import Advice, make_advice
from boresight.calibration.calibration import Calibration, PriorAgreement, PriorUse, Values
from boresight.calibration.estimate import Estimate, Parameters
from boresight.calibration.joint.passes import JointTelemetry, NamedTelemetry, join_sets
from boresight.calibration.options import OF_A_PRIOR, OPTIONS, CalibrationSettings
from boresight.calibration.problem import Problem
from boresight.calibration.result import OF_SEVERAL, ON_A_PRIOR, trend_entry
from boresight.calibration.telemetry_pieces import TelemetryInput, is_large
from boresight.cameras import CAMERA_MODELS
from boresight.errors import RefusedInputError
from boresight.estimation.prior import Prior
from boresight.estimation.statistics.special import chdtrc
from boresight.telemetry.sensors import Sensor

TELEMETRY, VALIDATION = "telemetry", "validation"
DAY_S = 86_400.0
#: Chance below which a prior and data that agree would look as far apart as they do.
DISAGREE = 1e-3
#: Chance that data which the prior does not hold agree with it so well.
SAME = 1e-6


@dataclass(frozen=True)
class PriorSource:
    """A calibration to start from, what refusals call it, and the SHA-256 of its file, where it has one.

    `held`, `ended_utc`: what is known besides of the telemetry that it was made from, by SHA-256, and of its last star.
    """

    calibration: Calibration
    name: str = "the prior"
    sha256: str | None = None
    held: frozenset[str] = frozenset()
    ended_utc: str | None = None

    @property
    def held_sets(self) -> set[str]:
        """SHA-256 of every telemetry set that it was made from, and its own prior."""
        found = self.calibration
        own = {sha256 for role, sha256 in found.inputs.sha256s.items() if role.startswith(TELEMETRY)}
        own |= {one.sha256 for one in found.inputs.passes if one.sha256 is not None}
        return own | self.held | set(found.prior.telemetry_sha256s if found.prior else ())

    @property
    def ended(self) -> np.datetime64 | None:
        """When its last star was taken, as far as it says."""
        return max(self._list_times(self.ended_utc, "end_utc", -1), default=None)

    @property
    def began(self) -> np.datetime64 | None:
        """When its first star was taken, as far as it says; where it has a prior of its own, after that."""
        return min(self._list_times(None, "start_utc", 0), default=None)

    def _list_times(self, told: str | None, of_pass: str, of_history: int) -> list[np.datetime64]:
        found = self.calibration
        times = [told, *(getattr(one, of_pass) for one in found.inputs.passes)]
        if found.history is not None and found.history.time_utc:
            times.append(found.history.time_utc[of_history])
        try:
            return list(parse_times([time for time in times if time]))
        except ValueError as error:
            raise RefusedInputError(
                f"{self.name} has an invalid time ({error}): write times as 2026-11-21T03:04:05Z."
            ) from error


@dataclass(frozen=True)
class TakenPrior:
    """A prior as a run takes it in: the Gaussian, what is told of its origin, and what is to be said of how it was taken.

    `of_noise`: (n_free, n_free) its covariance by noise alone, neither inflated nor aged, typical sigmas; None where none is told.
    """

    prior: Prior
    origin: PriorUse
    remarks: tuple[Advice, ...] = ()
    remedy: str = "compare with a run without --prior, or allow a drift by --prior-drift-sigma"
    of_noise: FloatArray | None = None

    def describe(
        self, problem: Problem, parameters: Parameters, settings: CalibrationSettings, estimate: Estimate
    ) -> PriorUse:
        """Say how much of an estimate came from it, and whether the data agree with it."""
        names = [problem.camera.parameter_names[p] for p in parameters.free]
        z = (estimate.x - self.prior.x)[parameters.free] / parameters.scale
        share: list[float] | list[None] = [None] * len(names)
        if not settings.sequential or (
            settings.process_noise == 0.0 and settings.process_noise_of is None and settings.forgetting_factor == 1.0
        ):
            share = self.prior.share(estimate.A).tolist()
        sigma = np.sqrt(np.diag(self.prior.P)) * parameters.scale
        found = replace(
            self.origin,
            parameters=Values(dict(zip(names, self.prior.x[parameters.free].tolist(), strict=True))),
            sigma=Values(dict(zip(names, sigma.tolist(), strict=True))),
            share=Values(dict(zip(names, share, strict=True))),
            agreement=_agreement(self.prior, estimate.A, z),
        )
        return replace(found, sentence=_sentence(found))

    def advice(self, use: PriorUse, parameters: Parameters, estimate: Estimate) -> list[Advice]:
        """What a person should know: of the prior's standing, and where the data contradict it or are its own."""
        if None not in use.share.values() and self._holds(parameters, estimate):
            same = (
                f"These data agree with {use.name} better than independent data could (probability below {SAME:g}): the prior was "
                "probably made from the same data under another name or format, which would count them twice. Give other "
                "telemetry, "
                "or omit --prior."
            )
            return [Advice(same, "prior"), *self.remarks]
        if use.agreement is None or use.agreement.p_value >= DISAGREE:
            return list(self.remarks)
        size = f"chi-square {use.agreement.chi2:.3g} for {use.agreement.dof} degrees of freedom"
        disagree = (
            f"These data contradict {use.name} ({size}): the camera changed, or one of the two is wrong; {self.remedy}."
        )
        return [Advice(disagree, "prior_contradicted"), *self.remarks]

    def _holds(self, parameters: Parameters, estimate: Estimate) -> bool:
        """Whether the data alone are nearer to the prior than data that it does not hold."""
        if self.of_noise is None:
            return False
        z = (estimate.x - self.prior.x)[parameters.free] / parameters.scale
        chi2, dof = self.prior.distance(estimate.A, z, self.of_noise)
        return dof > 0 and 1.0 - chdtrc(dof, chi2) < SAME


def _agreement(prior: Prior, A: FloatArray, z: FloatArray) -> PriorAgreement | None:
    chi2, dof = prior.disagreement(A, z)
    return PriorAgreement(chi2=chi2, dof=dof, p_value=float(chdtrc(dof, chi2))) if dof else None


def _sentence(use: PriorUse) -> str:
    """Say of each parameter how much of its variance the prior gave."""
    known = {name: share for name, share in use.share.items() if share is not None}
    aged = "" if use.age_days is None else f", {use.age_days:.3g} days old"
    if not known:
        return (
            f"Started from {use.name}{aged}. With process noise or forgetting, its share decreases over time and is not "
            "reported."
        )
    listed = ", ".join(f"{name} {share:.0%}" for name, share in known.items())
    return f"Share of each variance that comes from {use.name}{aged}: {listed}; the rest comes from these data."


def take_prior(
    source: PriorSource,
    sensor: Sensor,
    parameters: Parameters,
    settings: CalibrationSettings,
    begins: np.datetime64 | None,
) -> TakenPrior:
    """Make a former calibration what a run starts from; `begins`: the first known time of the run's own telemetry."""
    found = source.calibration
    if not found.is_usable:
        raise RefusedInputError(
            f"{source.name} ended {found.status.replace('_', ' ')}, so its result is not reliable: give a calibration that "
            "converged."
        )
    refuse_cosine(settings)
    names = CAMERA_MODELS[sensor.camera_model].parameter_names
    wanted = [names[p] for p in parameters.free]
    if sorted(wanted) != sorted(found.covariance.names):
        raise RefusedInputError(
            f"{source.name} estimated {', '.join(found.covariance.names)}, but this run frees {', '.join(wanted)}. Give "
            f"--free {','.join(found.covariance.names)}: its covariance is valid only with the same free parameters."
        )
    if missing := [name for name in names if name not in found.parameters]:
        raise RefusedInputError(f"{source.name} has no parameter {missing[0]}: give the file as it was written.")
    x = np.array([found.parameters[name] for name in names], np.float64)
    unit = np.outer(parameters.scale, parameters.scale)
    P = _covariance(found, wanted, settings) / unit
    # stated noise that was too large makes agreement look too good
    of_noise = _covariance(found, wanted, replace(settings, prior_covariance="noise")) / unit
    of_noise *= min(1.0, found.chi2_per_dof or 1.0)
    age = _age_days(source, settings, begins)
    aged = settings.prior_inflation**2 * P + settings.prior_drift_sigma**2 * (age or 0.0) * np.eye(len(P))
    if not np.isfinite(x).all() or not np.isfinite(aged).all() or np.linalg.eigvalsh(aged)[0] <= 0:
        raise RefusedInputError(f"{source.name} has no positive covariance: calibrate its telemetry again.")
    origin = PriorUse(
        name=source.name,
        sha256=source.sha256,
        telemetry_sha256s=sorted(source.held_sets),
        covariance=settings.prior_covariance,
        inflation=settings.prior_inflation,
        age_days=age,
        drift_sigma=settings.prior_drift_sigma,
    )
    return TakenPrior(Prior(x, aged), origin, tuple(make_advice("prior", _remarks(source, begins))), of_noise=of_noise)


def check_same_camera(source: PriorSource, sensor: Sensor) -> None:
    """Refuse a prior of another camera model or of another sensor."""
    found = source.calibration
    if found.camera_model != sensor.camera_model:
        raise RefusedInputError(
            f"{source.name} is of the camera model {found.camera_model}, the sensor file of {sensor.camera_model}: convert it, "
            "or give a calibration of that model."
        )
    if found.sensor != sensor.name:
        raise RefusedInputError(
            f"{source.name} is of the sensor {found.sensor}, the sensor file of {sensor.name}: give a calibration of this sensor."
        )


def _covariance(found: Calibration, wanted: Sequence[str], settings: CalibrationSettings) -> FloatArray:
    """Covariance of the wanted parameters, (n_free, n_free) SI, as the settings choose it."""
    entry = trend_entry(found)
    of_noise = settings.prior_covariance == "noise" or entry is None
    matrix = found.covariance.matrix if of_noise or entry is None else entry.covariance
    listed = found.covariance.names if of_noise or entry is None else entry.names
    place = [listed.index(name) for name in wanted]
    try:
        P = np.array(matrix, np.float64)
    except ValueError as error:
        raise RefusedInputError(
            "The prior's covariance is not a square of numbers: give the file as it was written."
        ) from error
    if P.shape != (len(listed), len(listed)):
        raise RefusedInputError(
            f"The prior's covariance is {' by '.join(map(str, P.shape))} for {len(listed)} names: give the file as it was written."
        )
    return P[np.ix_(place, place)]


def _age_days(source: PriorSource, settings: CalibrationSettings, begins: np.datetime64 | None) -> float | None:
    """Days between the prior's stars and the run's, or as the settings say; None where neither is known.

    A prior may be of later stars than the run: the camera walked between them all the same.
    """
    if settings.prior_age_days is not None:
        if settings.prior_drift_sigma == 0.0:
            raise RefusedInputError(
                "An age without a drift changes nothing: give --prior-drift-sigma too, or omit the age."
            )
        return settings.prior_age_days
    if source.ended is None or begins is None or np.isnat(begins):
        if settings.prior_drift_sigma > 0.0:
            raise RefusedInputError(
                f"The age of {source.name} cannot be determined from its times: give --prior-age-days."
            )
        return None
    before = source.ended if source.began is None else source.began
    apart = max(begins - source.ended, before - begins, np.timedelta64(0, "us"))
    return float(apart / np.timedelta64(1, "us")) / 1e6 / DAY_S


def _remarks(source: PriorSource, begins: np.datetime64 | None) -> list[str]:
    entry = trend_entry(source.calibration)
    said = []
    if entry is not None and entry.left_out not in {None, ON_A_PRIOR, OF_SEVERAL}:
        said.append(f"Use the prior with caution: {entry.left_out}. Compare with a run without --prior.")
    if not source.held_sets:
        said.append(
            "The prior does not name its telemetry, so Boresight cannot check whether it already contains these stars. Make sure "
            "that it does not, or they are counted twice."
        )
    if (
        begins is not None
        and source.began is not None
        and source.ended is not None
        and source.began <= begins <= source.ended
    ):
        said.append(
            f"These data begin within the times of the prior ({source.began}Z to {source.ended}Z): make sure that they are "
            "other frames, or their stars are counted twice."
        )
    return said


def without_held(
    telemetry: TelemetryInput, source: PriorSource, sha256s: Mapping[str, str]
) -> tuple[JointTelemetry, list[str]]:
    """Return what of telemetry the prior does not hold already, as passes, and a sentence on what was left out.

    Refuses where nothing is left, and a validation set that took part in the prior.
    """
    held = source.held_sets
    if sha256s.get(VALIDATION) in held:
        raise RefusedInputError(
            f"The validation set took part in {source.name}: choose one that did not.", code="prior-used-validation"
        )
    if not isinstance(telemetry, JointTelemetry):
        one = NamedTelemetry(telemetry, "The telemetry", sha256s.get(TELEMETRY))
        telemetry = join_sets([one], 0 if is_large(telemetry) else np.iinfo(np.int64).max)
    new = tuple(one for one in telemetry.sets if one.sha256 not in held)
    if not new:
        raise RefusedInputError(
            f"{source.name} already contains this telemetry, and stars must not be counted twice: give newer telemetry, or omit "
            "--prior.",
            code="prior-holds-telemetry",
        )
    left_out = [one.name for one in telemetry.sets if one.sha256 in held]
    if not left_out:
        return telemetry, []
    return replace(telemetry, sets=new), [
        f"Not used, because the prior already contains {'it' if len(left_out) == 1 else 'them'}: {', '.join(left_out)}."
    ]


def refuse_without_prior(settings: CalibrationSettings) -> None:
    """Refuse settings of priors where no prior is given."""
    for name, option in OPTIONS.items():
        if option.group == OF_A_PRIOR and getattr(settings, name) != option.default:
            raise RefusedInputError(f"{option.title} requires a prior: give --prior, or omit {option.flag}.")


def refuse_vary(settings: CalibrationSettings) -> None:
    """Refuse parameters of a pass beside a prior."""
    if settings.vary:
        raise RefusedInputError(
            "A prior describes a single camera and cannot be combined with parameters that vary between passes: omit --vary or "
            "--prior."
        )


def refuse_cosine(settings: CalibrationSettings) -> None:
    """Refuse an error that no prior can stand beside."""
    if settings.error == "cosine":
        raise RefusedInputError(
            "The cosine error has no weights and cannot be combined with a prior: choose error 'arclength'."
        )
