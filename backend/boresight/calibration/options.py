"""Every choice of a calibration, declared once: command line, form, REST schema, run summary and the site's list come from here.

A field of `CalibrationSettings` is an `Option`: its name, default, kind of value, bounds or words, unit, title, sentence, and the
methods that have it. A method is a row of `METHODS`. Nothing here loads an estimator, so that a command's help stays quick.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal

from boresight.errors import RefusedInputError
from boresight.estimation import MINIMUM_STARS

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, ValidatorFunctionWrapHandler

Kind = Literal["word", "whole", "number", "yes or no", "names", "numbers", "times", "wholes", "stars"]


@dataclass(frozen=True)
class MethodChoice:
    """One method: its name, title, when to use it, and whether it takes the frames one after the other."""

    name: str
    title: str
    when: str
    sequential: bool = True


METHODS = {
    method.name: method
    for method in (
        MethodChoice(
            "batch",
            "Batch",
            "All frames at once by least squares: the reference result, and the first run for a new set.",
            sequential=False,
        ),
        MethodChoice(
            "sqrf",
            "Square-root filter",
            "Frame by frame with a square-root covariance, as it would run on board: use it to see how fast the parameters"
            " converge and whether they drift.",
        ),
        MethodChoice(
            "ekf",
            "Extended Kalman filter",
            "The same filter with a full covariance: use it only to check the square-root filter.",
        ),
        MethodChoice(
            "ukf",
            "Unscented filter",
            "Propagates sample points spread over the parameter uncertainty instead of using derivatives: use it as an"
            " independent check of the square-root filter; it is slower and not more accurate.",
        ),
        MethodChoice(
            "svd",
            "Singular values",
            "Singular values of star combinations in place of arcs: use it to reproduce or compare with the method of Wu et al.;"
            " even with correct weights it uses slightly less information than arcs, and takes longer.",
        ),
        MethodChoice(
            "angular",
            "All angular distances",
            "Every pair of stars, the usual reference for singular values: use it to compare with them; it gives the"
            " same result as the arcs of the square-root filter, and takes longer.",
        ),
    )
}
ALL, BATCH = tuple(METHODS), ("batch",)
FILTERS = tuple(method.name for method in METHODS.values() if method.sequential)
EITHER_FORM = ("svd", "angular")
#: Headings of choices that the form of one run has by themselves; the runs of a campaign take one set each, without a prior.
OF_ONE_RUN = OF_A_JOINT_CALIBRATION, OF_A_PRIOR = ("Joint calibration", "Prior")
#: Headings of the choices, with the methods that have those of each.
GROUPS = {
    "Method": ALL,
    "Matching": ALL,
    OF_A_JOINT_CALIBRATION: ALL,
    OF_A_PRIOR: ALL,
    "Batch": BATCH,
    "Filters": FILTERS,
    "Process noise": FILTERS,
    "Singular values and all angular distances": EITHER_FORM,
}
#: Headings of a form's sets of fields, by the methods that have them and whether they are usual.
LEGENDS = {
    (FILTERS, True): "Filter",
    (("svd",), True): "Singular values",
    (ALL, False): "Stars and matches",
    (BATCH, False): "Batch",
    (FILTERS, False): "Further filter settings",
    (EITHER_FORM, False): "Singular values and all angular distances",
}


@dataclass(frozen=True)
class Option:
    """One choice of a calibration.

    `methods` have it; `title` and `unit` are what a person chooses by; `sentence` says what it is or does; `words` may be chosen,
    each with its meaning; `lowest` and `highest` bound a number; `hint` stands beneath a form's field; `flag` is its name on the
    command line, where it has one; `elsewhere` refuses any but the default under another method, which without one has no effect;
    a form shows what is `usual` at once, and the others among more options, in a `cell` by row and column of their set of fields;
    `radios` show every word.
    """

    name: str
    default: Any
    kind: Kind
    group: str
    methods: tuple[str, ...]
    title: str
    sentence: str
    unit: str = ""
    words: Mapping[str, str] = field(default_factory=dict)
    lowest: float = 0.0
    highest: float = 0.0
    hint: str = ""
    flag: str | None = None
    elsewhere: str = ""
    usual: bool = False
    cell: tuple[int, int] | None = None
    radios: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @property
    def range(self) -> str:
        """What may be given, in words."""
        if self.kind == "word":
            return ", ".join(self.words)
        shown = "g" if self.kind == "number" else ""
        ends = f"{self.lowest:{shown}} to {self.highest:{shown}}" if self.highest else ""
        return (
            ends
            or {
                "yes or no": "yes or no",
                "names": "parameter names",
                "numbers": "parameter names with numbers",
                "times": "times, UTC",
                "wholes": "some of 1, 2, 3",
                "stars": "Hipparcos numbers",
            }[self.kind]
        )

    def counts_under(self, method: str) -> bool:
        """Whether it changes what a method does: matching begins with the spread of the start under every one."""
        return method in self.methods or self.name == "initial_sigma_scale"

    def check(self, value: Any) -> None:
        """Refuse a value of another kind or outside the bounds, NaN included."""
        if (value is None and self.default is None) or self._allows(value):
            return
        if self.kind == "names":
            raise RefusedInputError(
                f"Setting {self.name!r} is not a list of parameter names: give at least one name, or omit it."
            )
        give = {
            "word": f"choose from {self.range}",
            "whole": f"give a whole number from {self.range}",
            "number": f"give a number from {self.range}",
            "yes or no": "give true or false",
            "numbers": f'give parameters with numbers from {self.lowest:g} to {self.highest:g}, as ["f_m=0.5"]',
            "times": 'give at least one time, as ["2026-03-02T10:00:00Z"]',
            "wholes": "give some of 1, 2, 3, as [2, 3]",
            "stars": f"give at most {MOST_STARS_LEFT_OUT} Hipparcos numbers, as [71683, 71681]",
        }
        raise RefusedInputError(f"Setting {self.name!r} is {value!r}; {give[self.kind]}.")

    def _allows(self, value: Any) -> bool:
        if self.kind == "word":
            return isinstance(value, str) and value in self.words
        if self.kind == "yes or no" or isinstance(value, bool):
            return self.kind == "yes or no" and isinstance(value, bool)
        if self.kind in ("whole", "number"):
            return (
                isinstance(value, int if self.kind == "whole" else int | float) and self.lowest <= value <= self.highest
            )
        if not isinstance(value, list | tuple) or not (value or self.kind == "stars"):
            return False
        if self.kind in TEXTS:
            return all(isinstance(text, str) and (self.kind != "numbers" or self._names_number(text)) for text in value)
        highest, most = (LAST_STAR, MOST_STARS_LEFT_OUT) if self.kind == "stars" else (3, 3)
        return all(type(k) is int and 1 <= k <= highest for k in value) and len(set(value)) == len(value) <= most

    def _names_number(self, text: str) -> bool:
        name, _, number = text.partition("=")
        try:
            return bool(name) and self.lowest <= float(number) <= self.highest
        except ValueError:
            return False

    def read(self, text: str) -> Any:  # noqa: PLR0911 - one a kind
        """Read what was typed into a form; a comma stands for a point, as many keyboards have it."""
        text = text.strip()
        if self.kind == "yes or no":
            return bool(text)
        if self.kind == "stars":
            return [self._whole(part) for part in text.split(",") if part.strip()]
        if self.kind == "wholes":
            return [self._whole(part) for part in text.split(",")]
        if self.kind in TEXTS:
            return [part.strip() for part in text.split(",") if part.strip()] or None
        if self.kind == "whole":
            return self._whole(text)
        if self.kind == "number":
            return None if self.default is None and not text else self._number(text)
        return text

    def schema(self) -> dict[str, Any]:
        """Describe it as JSON Schema."""
        said: dict[str, Any] = {"description": self.sentence}
        if self.kind == "word":
            said |= {"type": "string", "enum": list(self.words)}
        elif self.kind in ("whole", "number"):
            said |= {
                "type": "integer" if self.kind == "whole" else "number",
                "minimum": self.lowest,
                "maximum": self.highest,
            }
        elif self.kind == "yes or no":
            said |= {"type": "boolean"}
        elif self.kind == "stars":
            star = {"type": "integer", "minimum": 1, "maximum": LAST_STAR}
            said |= {"type": "array", "items": star, "maxItems": MOST_STARS_LEFT_OUT}
        else:
            item = {"type": "string"} if self.kind in TEXTS else {"type": "integer", "minimum": 1, "maximum": 3}
            said |= {"type": "array", "items": item, "minItems": 1}
        if self.default is None:
            said["type"] = [said["type"], "null"]
        return said | {"default": list(self.default) if isinstance(self.default, tuple) else self.default}

    def _whole(self, text: str) -> int:
        text = text.strip()
        if not text.isdecimal() or len(text.lstrip("0")) > MOST_DIGITS:
            raise RefusedInputError(
                f"{self.title}: {text[:20]!r} is not a whole number; type one, such as {format_value(self.default) or 6}."
            )
        return int(text)

    def _number(self, text: str) -> float:
        try:
            return float(text.replace(",", ".") or "0")
        except ValueError as error:
            raise RefusedInputError(
                f"{self.title}: {text[:20]!r} is not a number; type one, such as {format_value(self.default) or 0.02}."
            ) from error


#: The last Hipparcos number, and most stars that are left out by number: with more it is the catalogue that is wrong.
LAST_STAR, MOST_STARS_LEFT_OUT = 120_416, 200
#: Kinds that are lists of texts.
TEXTS = ("names", "numbers", "times")
#: Drift of every parameter a frame where nobody states it and the data do not tell it, typical sigmas.
USUAL_DRIFT = 0.02
#: A whole number of more is none of ours.
MOST_DIGITS = 9


def option(group: str, title: str, sentence: str, *, methods: tuple[str, ...] = (), **said: Any) -> Any:
    """Declare a choice: a field of the settings with its `Option`, whose name and default are the field's."""
    default, words = said["default"], said.get("words")
    kinds = {bool: "yes or no", int: "whole", float: "number", str: "word"}
    said.setdefault("kind", "word" if words and isinstance(default, str) else kinds.get(type(default), "names"))
    declared = {"group": group, "title": title, "sentence": sentence, "methods": methods or GROUPS[group], **said}
    return field(default=default, metadata={"option": declared})


@dataclass(frozen=True)
class CalibrationSettings:
    """What to estimate and how; each field's meaning is its option's sentence."""

    method: str = option(
        "Method", "Method", "Estimator.", default="batch", flag="--method", usual=True,
        words={method.name: method.title for method in METHODS.values()},
    )  # fmt: skip
    variant: str = option(
        "Method", "Process noise",
        "For filters: no-q keeps parameters constant; q follows drift; no-refit is q with the matches of the initial parameters.",
        cell=(1, 1), radios=True, default="no-q", flag="--variant", methods=FILTERS, usual=True,
        words={
            "no-q": "No-Q: parameters are constant",
            "q": "Q: parameters may drift",
            "no-refit": "No-Refit: Q, with the matches of the initial parameters only",
        },
    )  # fmt: skip
    free: tuple[str, ...] | None = option(
        "Method", "Free parameters", "Parameters to estimate, such as f_m,b2_per_m2; the sensor's own list if omitted.",
        default=None, kind="names", flag="--free", usual=True,
    )  # fmt: skip
    match: str = option(
        "Matching", "Star identities", "Star identities: those in the file, verified, or matched again as parameters improve.",
        default="rematch", flag="--match", usual=True,
        words={"given": "From the file, verified", "rematch": "Matched again as parameters improve"},
    )  # fmt: skip
    match_parameters: str = option(
        "Matching", "Parameters for matching", "Parameters with which a filter matches each frame.",
        cell=(1, 1), default="latest", flag="--match-parameters", methods=FILTERS,
        words={"latest": "The latest, frame by frame", "baseline": "The parameters it started from"},
    )  # fmt: skip
    match_rule: str = option(
        "Matching", "Tolerance of a match", "Tolerance of a match: from its noise, or the fixed one of the flight code.",
        cell=(1, 1), default="statistical", flag="--match-rule",
        words={
            "statistical": "Statistical: from centroid noise and parameter uncertainty",
            "flight": "Flight: the fixed tolerance of the flight code",
        },
    )  # fmt: skip
    flight_tolerance_urad: float | None = option(
        "Matching", "Flight tolerance",
        "Largest disagreement of an arc that the flight code accepts; five sigmas of an arc if omitted.",
        cell=(1, 2), default=None, kind="number", lowest=0.1, highest=1e5, unit="µrad", flag="--flight-tolerance-urad",
        hint="Empty: five sigmas of an arc.",
    )  # fmt: skip
    leave_out_doubles: bool = option(
        "Matching", "Leave out doubles and unreliable stars",
        "Leave out double stars and stars with unreliable astrometry.", cell=(2, 2), default=False, flag="--leave-out-doubles",
    )  # fmt: skip
    leave_out_stars: tuple[int, ...] = option(
        "Matching", "Stars left out", "Stars to leave out, by Hipparcos number, such as 71683,71681.",
        cell=(4, 2), default=(), kind="stars", flag="--leave-out-stars", hint="Hipparcos numbers, such as 71683,71681.",
    )  # fmt: skip
    blends: str = option(
        "Matching", "Blended stars",
        "Stars whose centroid is shifted by more than 0.4 sigma by a catalogue neighbour; needs psf_sigma_px, which images have.",
        cell=(3, 2), default="leave-out", flag="--blends",
        words={"leave-out": "Leave out if the width of the star images is known", "keep": "Keep"},
    )  # fmt: skip
    noise_model: str = option(
        "Method", "Centroid noise", "Centroid noise: as stated, or corrected where the data show a significant deviation.",
        cell=(3, 1), default="stated", flag="--noise-model",
        words={
            "stated": "As stated by telemetry or sensor file",
            "from-data": "From the data: magnitude, field angle, rate, pixel phase and colour, where needed",
        },
    )  # fmt: skip
    minimum_stars: int = option(
        "Method", "Minimum stars per exposure", "Exposures with fewer stars are not used.",
        cell=(2, 1), default=MINIMUM_STARS, lowest=MINIMUM_STARS, highest=1000, flag="--minimum-stars",
    )  # fmt: skip
    vary: tuple[str, ...] | None = option(
        OF_A_JOINT_CALIBRATION, "Parameters of a pass",
        "Parameters estimated separately for each telemetry set, for example f_m,m0_px.",
        cell=(0, 0), default=None, kind="names", flag="--vary",
        hint="Empty: the same in every set. Parameter names separated by commas.",
    )  # fmt: skip
    vary_as: str = option(
        OF_A_JOINT_CALIBRATION, "How they vary", "How parameters vary from pass to pass.", cell=(1, 0), default="pass",
        flag="--vary-as",
        words={
            "pass": "Each pass by itself",
            "walk": "A random walk from pass to pass",
            "walk-and-temperature": "A random walk around a linear temperature trend",
            "temperature": "By the mean temperature of a pass",
            "drift": "By time",
            "step": "In steps, at events or at dates that the data propose",
            "evidence": "A walk around trends in temperature and time, with steps; each term is included only if the passes "
            "support it",
        },
    )  # fmt: skip
    degree: str = option(
        OF_A_JOINT_CALIBRATION, "Degree", "For temperature and drift: polynomial degree; auto chooses it from the data.",
        cell=(2, 0), default="1", flag="--degree",
        words={
            "1": "Linear",
            "2": "Quadratic",
            "3": "Cubic",
            "auto": "Up to 3, chosen from the data for each parameter; 0 is no change",
        },
    )  # fmt: skip
    events: tuple[str, ...] | None = option(
        OF_A_JOINT_CALIBRATION, "Events", "For step: times of events, for example 2026-03-02T10:00:00Z; searched for if omitted.",
        cell=(2, 1), default=None, kind="times", flag="--events",
    )  # fmt: skip
    walk_sigma: float | None = option(
        OF_A_JOINT_CALIBRATION, "Step of the walk",
        "For walks: drift in typical sigmas per square root of a day; estimated from the passes if omitted.",
        cell=(1, 1), default=None, kind="number", lowest=1e-4, highest=100.0, unit="typical σ/√d", flag="--walk-sigma",
        hint="Empty: the most likely drift of each parameter.",
    )  # fmt: skip
    prior_covariance: str = option(
        OF_A_PRIOR, "Covariance of the prior", "Covariance used for a prior.", cell=(0, 0), default="with-misfit",
        flag="--prior-covariance",
        words={
            "with-misfit": "With misfit, as used for decisions",
            "noise": "From noise alone: prior and data together then equal a joint fit",
        },
    )  # fmt: skip
    prior_inflation: float = option(
        OF_A_PRIOR, "Inflation of the prior", "Factor by which the sigmas of a prior are multiplied.", cell=(1, 0),
        default=1.0, lowest=1.0, highest=1e3, flag="--prior-inflation",
    )  # fmt: skip
    prior_drift_sigma: float = option(
        OF_A_PRIOR, "Drift since the prior", "Assumed drift since the prior, in typical sigmas per square root of a day.",
        cell=(1, 1), default=0.0, lowest=0.0, highest=10.0, unit="typical σ/√d", flag="--prior-drift-sigma",
    )  # fmt: skip
    prior_age_days: float | None = option(
        OF_A_PRIOR, "Age of the prior",
        "Days between the last star of the prior and the first star of the run; computed from their times if omitted.",
        cell=(1, 2), default=None, kind="number", lowest=0.0, highest=36_525.0, unit="d", flag="--prior-age-days",
    )  # fmt: skip
    max_iterations: int = option(
        "Batch", "Maximum iterations", "Maximum number of iterations.",
        cell=(1, 2), default=50, lowest=1, highest=10_000, flag="--max-iterations",
    )  # fmt: skip
    error: str = option(
        "Batch", "Error minimised", "Error to minimise; cosine is less accurate and only for comparison.",
        cell=(1, 1), default="arclength", flag="--error",
        words={
            "arclength": "Arclength with its full covariance",
            "cosine": "Cosine of the arc, unweighted: less accurate, only for comparison",
        },
        elsewhere="The cosine error works only with method 'batch': choose it, or error 'arclength'.",
    )  # fmt: skip
    robust: str = option(
        "Batch", "Loss", "Loss that limits the effect of false stars; huber is less effective and only for comparison.",
        cell=(2, 1), default="none", flag="--robust",
        words={
            "none": "Least squares",
            "stars": "By stars: stars that are far off are ignored",
            "huber": "Huber on arcs: limits the effect of false stars, only for comparison",
        },
        elsewhere="Robust loss works only with method 'batch': choose it, or set 'robust' to 'none'.",
    )  # fmt: skip
    huber_threshold: float = option(
        "Batch", "Huber threshold", "For huber, in whitened sigmas.",
        cell=(2, 2), default=1.345, lowest=0.1, highest=10.0, unit="whitened σ", flag="--huber-threshold",
        hint="1.345 keeps 95 % of the efficiency for Gaussian noise.",
    )  # fmt: skip
    linearisations: int = option(
        "Filters", "Linearisations per frame", "Maximum linearisations per frame; 1 reproduces the published filter.",
        cell=(2, 1), default=6, lowest=1, highest=100, flag="--linearisations", usual=True,
        hint="1 reproduces the published filter; with more, the state converges within each frame.",
    )  # fmt: skip
    process_noise_sigma: float | None = option(
        "Filters", "Drift per frame",
        "For q and no-refit: drift in typical sigmas. If omitted, it is estimated from the data where possible, otherwise 0.02 "
        "per frame.",
        cell=(1, 2), default=None, kind="number", lowest=0.0, highest=10.0, unit="typical σ", flag="--process-noise", usual=True,
        hint="Not used with No-Q. If empty: estimated from the data if there are at least five passes, otherwise 0.02.",
    )  # fmt: skip
    process_noise_of: tuple[str, ...] | None = option(
        "Process noise", "Drift by parameter",
        "Drift of individual parameters, overriding the general value, for example f_m=0.05,b2_per_m2=0.",
        cell=(4, 1), default=None, kind="numbers", lowest=0.0, highest=10.0, unit="typical σ", flag="--process-noise-of",
    )  # fmt: skip
    process_noise_per: str = option(
        "Process noise", "Drift unit", "Unit of drift: per frame, or per square root of a day (computed from the frame times).",
        cell=(4, 2), default="frame", flag="--process-noise-per",
        words={"frame": "Per frame, whatever the gap before it", "day": "Per square root of a day, from the time between frames"},
        elsewhere="Process noise is only for filters: choose a filter, or omit 'process_noise_per'.",
    )  # fmt: skip
    smooth: bool = option(
        "Filters", "Smooth", "In addition to the filter, estimate the parameters at each frame's time from all frames.",
        cell=(3, 1), default=False, flag="--smooth", usual=True,
        elsewhere="A smoother runs beside a filter: choose a filter, or leave 'smooth' off.",
    )  # fmt: skip
    forgetting_factor: float = option(
        "Filters", "Forgetting factor", "Share of the information kept from frame to frame.",
        cell=(2, 1), default=1.0, lowest=0.5, highest=1.0, flag="--forgetting-factor",
        hint="Share of the information kept from frame to frame; 1 forgets nothing.",
        elsewhere=(
            f"A forgetting factor is only for filters: choose from {', '.join(FILTERS)}, or leave 'forgetting_factor' at 1."
        ),
    )  # fmt: skip
    initial_sigma_scale: float = option(
        "Filters", "Initial sigma", "Initial sigma, in typical sigmas.",
        cell=(2, 2), default=10.0, lowest=1e-3, highest=1e4, unit="typical σ", flag="--initial-sigma-scale",
    )  # fmt: skip
    star_model: int = option(
        "Singular values and all angular distances", "Star combinations",
        "For svd: star combinations, 1 to 4; 4 is the paper's choice.",
        cell=(1, 1), default=4, lowest=1, highest=4, methods=("svd",), flag="--star-model", usual=True,
        words={
            "1": "1: three neighbours at a time",
            "2": "2: half of the stars at a time",
            "3": "3: all stars but one at a time",
            "4": "4: the first three, four, five … all stars",
        },
        elsewhere="Star model and singular values are only for method 'svd': choose it, or omit them.",
    )  # fmt: skip
    singular_values: tuple[int, ...] = option(
        "Singular values and all angular distances", "Singular values",
        "For svd: some of 1,2,3; the first adds nothing to the others, because their squares add up to the number of stars.",
        cell=(1, 2), default=(2, 3), kind="wholes", methods=("svd",), flag="--singular-values", usual=True,
        words={
            "2,3": "σ2 and σ3: all information of a combination",
            "1,2,3": "σ1, σ2 and σ3: the same, because σ1 follows from the others",
            "1,2": "σ1 and σ2: the same information",
            "1,3": "σ1 and σ3: the same information",
            "1": "σ1 alone",
            "2": "σ2 alone",
            "3": "σ3 alone",
        },
        hint=(
            "σ1 adds nothing to the other two: the squares of the three add up to the number of stars, whatever the camera."
        ),
        elsewhere="Star model and singular values are only for method 'svd': choose it, or omit them.",
    )  # fmt: skip
    gain_form: str = option(
        "Singular values and all angular distances", "Update",
        "How the update is computed; gain is the published form (slower, same result).",
        cell=(1, 1), default="information", flag="--gain-form",
        words={"information": "Information form", "gain": "Gain form, as published (slower, same result)"},
        elsewhere=f"The gain form applies only to methods {' and '.join(EITHER_FORM)}: choose one of them, or omit 'gain_form'.",
    )  # fmt: skip
    replay_frames_per_s: float = option(
        "Filters", "Replay pace", "Rate at which a filter processes frames; 0: as fast as possible.",
        cell=(2, 2), default=0.0, lowest=0.0, highest=1e6, unit="frames per second", usual=True,
        hint="As a downlink would deliver them; 0: as fast as possible.",
    )  # fmt: skip

    @property
    def sequential(self) -> bool:
        """Whether a filter runs."""
        return self.method in FILTERS

    @property
    def matched_with(self) -> str:
        """Which parameters a filter matches each frame with: the variant `no-refit` allows none but the baseline."""
        return "baseline" if self.variant == "no-refit" else self.match_parameters

    @property
    def drifts(self) -> bool:
        """Whether a filter lets the parameters change."""
        return self.sequential and self.variant != "no-q"

    @property
    def process_noise(self) -> float:
        """Standard deviation that a filter adds, in typical sigmas, where the data do not say it; 0 of constant parameters."""
        if self.variant == "no-q":
            return 0.0
        return USUAL_DRIFT if self.process_noise_sigma is None else self.process_noise_sigma

    @property
    def states_drift(self) -> bool:
        """Whether a person said how far the parameters drift."""
        return self.process_noise_sigma is not None or self.process_noise_of is not None

    @classmethod
    def parse(cls, document: Mapping[str, Any]) -> CalibrationSettings:
        """Read settings from a JSON document, absent keys taking their defaults."""
        for key in document:
            if key not in OPTIONS:
                raise RefusedInputError(
                    f"Setting {key!r} is unknown; choose from {', '.join(sorted(OPTIONS))}.", code="unknown-setting"
                )
        for name, value in document.items():
            OPTIONS[name].check(value)
        settings = cls(**{name: _normalise(OPTIONS[name], value) for name, value in document.items()})
        settings.check()
        return settings

    def check(self) -> None:
        """Refuse values outside their range and choices that exclude one another, one sentence each."""
        for name, declared in OPTIONS.items():
            declared.check(getattr(self, name))
        for name, declared in OPTIONS.items():
            if declared.elsewhere and self.method not in declared.methods and getattr(self, name) != declared.default:
                raise RefusedInputError(declared.elsewhere)
        if self.error == "cosine" and self.robust != "none":
            raise RefusedInputError("The cosine error has no weights for a robust loss: set 'robust' to 'none'.")
        if self.smooth and self.forgetting_factor != 1.0:
            raise RefusedInputError(
                "A smoother cannot be used with a forgetting factor: set 'forgetting_factor' to 1, or turn 'smooth' off."
            )
        if self.process_noise_per == "day" and not self.states_drift and self.variant != "no-q":
            raise RefusedInputError(
                "There is no default for drift per day: give --process-noise, or omit --process-noise-per."
            )

    def document(self) -> dict[str, Any]:
        """Return the settings as JSON values, every key present."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


def _normalise(declared: Option, value: Any) -> Any:
    """Keep a list as a tuple, numbers in ascending order."""
    if not isinstance(value, list | tuple):
        return value
    return tuple(sorted(value) if declared.kind in ("wholes", "stars") else value)


#: Every choice by its name, in the order of a settings document.
OPTIONS = {item.name: Option(name=item.name, **item.metadata["option"]) for item in fields(CalibrationSettings)}


@dataclass(frozen=True)
class StatedSettings(CalibrationSettings):
    """Settings as a document states them: those that it names are `stated`, in its order; the others are at their defaults.

    A calibration under way names none, and one of an earlier version not those that came later; it is written as it was read.
    """

    stated: tuple[str, ...] = ()

    @classmethod
    def of(cls, settings: CalibrationSettings) -> StatedSettings:
        """State every one of these settings."""
        return cls(**{name: getattr(settings, name) for name in OPTIONS}, stated=tuple(OPTIONS))

    def document(self) -> dict[str, Any]:
        """Return the stated settings as JSON values."""
        whole = {name: getattr(self, name) for name in self.stated}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in whole.items()}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """Read them from a JSON object by the types of the settings; a name that is not known here is dropped."""
        from pydantic_core import core_schema  # noqa: PLC0415 - only where JSON is read

        return core_schema.no_info_wrap_validator_function(
            cls._read,
            handler.generate_schema(CalibrationSettings),
            serialization=core_schema.plain_serializer_function_ser_schema(cls.document),
        )

    @classmethod
    def _read(cls, document: Any, read: ValidatorFunctionWrapHandler) -> StatedSettings:
        if isinstance(document, cls):
            return document
        found = read(document)
        stated = {name: getattr(found, name) for name in document if name in OPTIONS}
        as_written = {name: document[name] if document[name] == value else value for name, value in stated.items()}
        return cls(**as_written, stated=tuple(stated))


@dataclass(frozen=True)
class Fieldset:
    """Choices that a form shows together, row by row."""

    legend: str
    methods: tuple[str, ...]
    rows: Sequence[Sequence[Option]]


def make_fieldsets(*, usual: bool) -> list[Fieldset]:
    """Lay out the choices that a form shows at once, or among more options."""
    made = []
    for (methods, at_once), legend in LEGENDS.items():
        held = [
            one
            for one in OPTIONS.values()
            if one.cell and one.methods == methods and one.usual == at_once == usual and one.group not in OF_ONE_RUN
        ]
        if held:
            made.append(Fieldset(legend, methods, _lay_rows(held)))
    return made


def _lay_rows(held: Sequence[Option]) -> list[list[Option]]:
    """Lay options out by their cells."""
    ordered = sorted(held, key=lambda one: one.cell or (0, 0))
    return [list(row) for _, row in itertools.groupby(ordered, key=lambda one: (one.cell or (0, 0))[0])]


#: What a form of a calibration shows.
FORM = {
    "usual": make_fieldsets(usual=True),
    "more": make_fieldsets(usual=False),
    "of_one_run": [
        Fieldset(group, ALL, _lay_rows([one for one in OPTIONS.values() if one.group == group])) for group in OF_ONE_RUN
    ],
    "match": OPTIONS["match"],
}


def format_value(value: Any) -> str:
    """Write a value as a form or a command shows it."""
    if isinstance(value, bool):
        return "on" if value else ""
    if isinstance(value, list | tuple):
        return ",".join(map(str, value))
    return f"{value:.15g}" if isinstance(value, int | float) else str(value or "")


def describe_value(name: str, value: Any) -> str:
    """Say what a value means, for a person."""
    declared = OPTIONS[name]
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "the sensor's own" if name == "free" else "default"
    if declared.kind == "stars" and not value:
        return "none"
    text = format_value(value)
    return declared.words.get(text, text.replace(",", ", ") if isinstance(value, list | tuple) else text)


def get_method_title(method: str) -> str:
    """Return a method's title; its name where it has none."""
    return METHODS[method].title if method in METHODS else method


def is_sequential(method: str) -> bool:
    """Tell whether a method takes the frames one after the other."""
    return method in FILTERS


def schema() -> dict[str, Any]:
    """Describe a settings document as JSON Schema."""
    properties = {name: declared.schema() for name, declared in OPTIONS.items()}
    return {"type": "object", "properties": properties, "additionalProperties": False}


def listed(groups: Sequence[str] = tuple(GROUPS)) -> str:
    """Write every option of the command line as a Markdown table, by group."""
    chosen = [declared for group in groups for declared in OPTIONS.values() if declared.group == group]
    methods = {ALL: "all", FILTERS: "filters"}
    cells = [
        (
            f"`{item.flag}`",
            item.range,
            format_value(item.default) or "none",
            methods.get(item.methods) or ", ".join(item.methods),
            item.sentence,
        )
        for item in chosen
        if item.flag
    ]
    rows = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join(["| Option | Values | Default | Methods | What |", "| --- | --- | --- | --- | --- |", *rows])
