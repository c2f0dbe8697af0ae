"""What is assumed of a constellation, what each thing costs by the part `footprint`, and what follows a day."""  # noqa: INP001 - beside the scripts that use it

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

DAY_S, YEAR_D = 86_400.0, 365.25

#: name -> (value, unit, why)
ASSUMED: dict[str, tuple[float, str, str]] = {
    "trackers": (10_000, "", "the constellation"),
    "frames": (2_000, "a tracker and day", "one downlinked set a day, two exposures of about twelve stars each"),
    "passes": (15, "a day", "orbits of 96 minutes; the second plan sends a set at each"),
    "busy": (0.5, "", "share of a core that may be used on average: the rest is for peaks, repeats and upgrades"),
    "peak": (3, "", "writes and uploads of the busiest hour over the mean: downlinks come in bunches"),
    "people": (100, "", "consoles open at once, each following the feed"),
    "views": (2, "a minute and console", "pages or figures looked at"),
    "polls": (5, "a second", "reads of programs: telemetry chains, dashboards, monitoring"),
    "disk": (4, "TB", "of one disk"),
    "cores": (16, "", "of one machine"),
}


#: Queued, running, ended, and as many lines of progress.
EVENTS_A_RUN = 6
#: Launch, claim and settlement each by itself; runs of a group share the last two.
MOST_TRANSACTIONS_A_RUN = 3.0


@dataclass(frozen=True)
class Plan:
    """How often what is calibrated.

    Parameters
    ----------
    name
        In words.
    sets
        Sets a tracker and day, with their frames.
    runs
        (method, frames, runs a tracker and day).
    """

    name: str
    sets: tuple[tuple[float, float], ...]
    runs: tuple[tuple[str, float, float], ...]


def value(name: str) -> float:
    """Value of an assumption."""
    return ASSUMED[name][0]


def plans() -> list[Plan]:
    """Once a day, and after every orbit."""
    a_pass = value("frames") / value("passes")
    daily = Plan("daily", ((1, value("frames")),), (("batch", value("frames"), 1), ("sqrf", value("frames"), 1)))
    orbits = Plan(
        "every orbit",
        ((value("passes"), a_pass),),
        (("sqrf", a_pass, value("passes")), ("batch", a_pass, value("passes"))),
    )
    return [daily, orbits]


@dataclass(frozen=True)
class Costs:
    """What one thing costs on one database.

    Parameters
    ----------
    found
        By the part `footprint`.
    queue
        By the part `queue`, or nothing: its thousands of runs tell the server's cost of each from what it costs to be there.
    """

    found: dict[str, Any]
    queue: dict[str, Any]

    @property
    def _calm(self) -> dict[str, Any]:
        """Found by the pass of the part `queue` without kills, if it was measured."""
        calm: dict[str, Any] = self.queue.get("calm", {})
        return calm

    @property
    def server_run_s(self) -> float:
        """Processor seconds of the server's process a run."""
        return self._calm["server_cpu_ms_per_run"] / 1e3 if self.server_by_queue else self.mean_run("server_cpu_s")

    @property
    def server_by_queue(self) -> bool:
        """Whether the server's cost is that of the part `queue`, and not the fall-back."""
        return "server_cpu_ms_per_run" in self._calm

    @property
    def transactions_a_run(self) -> float:
        """One to launch it, and what it took of those that claim and settle groups; the most where that was not measured."""
        if not self.groups_measured:
            return MOST_TRANSACTIONS_A_RUN
        return 1.0 + float(self._calm["claims_per_run"]) + float(self._calm["settlements_per_run"])

    @property
    def groups_measured(self) -> bool:
        """Whether it was measured how many runs share a transaction."""
        return "claims_per_run" in self._calm

    @property
    def set_cpu_s(self) -> float | None:
        """Processor seconds of an upload, or None where only its wall seconds were measured, which are another thing."""
        costs = self.found["set"].values()
        return self.mean_set("own_cpu_s") if all("own_cpu_s" in cost for cost in costs) else None

    def run(self, method: str, key: str, frames: float) -> float:
        """`worker_cpu_s` or `blob_bytes` of a run of so many frames: constant and slope."""
        line = self.found["run"][method]["line"][key]
        return float(max(0.0, line["constant"]) + line["per_frame"] * frames)

    def mean_run(self, key: str) -> float:
        """What does not depend on frames, averaged over the runs of all methods and lengths."""
        costs = [
            cost[key] for of_method in self.found["run"].values() for name, cost in of_method.items() if name != "line"
        ]
        return float(sum(costs) / len(costs))

    @property
    def rows_a_run(self) -> float:
        """Rows that a run writes, its audit records and log lines among them."""
        costs = [
            cost["rows"]
            for of_method in self.found["run"].values()
            for name, cost in of_method.items()
            if name != "line"
        ]
        return sum(sum(rows.values()) for rows in costs) / len(costs)

    def set_bytes(self, frames: float) -> float:
        """Bytes of files of a set: the upload and the table made of it."""
        (short, cost), (long, longer) = ((int(name), cost) for name, cost in self.found["set"].items())
        slope = (longer["blob_bytes"] - cost["blob_bytes"]) / (long - short)
        return float(max(0.0, cost["blob_bytes"] - slope * short) + slope * frames)

    def mean_set(self, key: str) -> float:
        """Of a set, averaged over both lengths."""
        costs = [cost[key] for cost in self.found["set"].values()]
        return float(sum(costs) / len(costs))

    @property
    def rows_a_set(self) -> float:
        """Rows that a set writes."""
        return sum(next(iter(self.found["set"].values()))["rows"].values())

    @property
    def transactions_per_s(self) -> float:
        """Transactions a second of the single writer, one after the other."""
        return float(1 / self.found["launch"]["seconds"])

    @property
    def rows_per_s(self) -> float | None:
        """Rows a second of the single writer, many to a transaction, or None where that was not measured."""
        bulk = self.found.get("launch_in_bulk")
        return None if bulk is None else float(sum(bulk["rows"].values()) / bulk["seconds"])

    @property
    def lengths(self) -> tuple[int, int]:
        """Frames of the two sets that were measured."""
        short, long = sorted(int(name) for name in self.found["set"])
        return short, long


def amounts(plan: Plan) -> tuple[float, float]:
    """Sets and runs a day."""
    return value("trackers") * plan.sets[0][0], value("trackers") * sum(times for _, _, times in plan.runs)


def events_per_s(plan: Plan) -> float:
    """Events of the feed a second in the busiest hour."""
    return EVENTS_A_RUN * amounts(plan)[1] / DAY_S * value("peak")


def asked_per_s() -> float:
    """Reads a second of people and programs."""
    return value("people") * value("views") / 60 + value("polls")


def read_s(document: dict[str, Any]) -> float | None:
    """Processor seconds of the server a read, or None: people look at pages made anew after a commit, programs at lists."""
    found = document.get("clients", {}).get("found", {})
    page, polled = (
        found.get(name, {}).get("server_us_per_request") for name in ("page_while_writing", "list_while_writing")
    )
    if page is None or polled is None:
        return None
    views = value("people") * value("views") / 60
    return float(views * page + value("polls") * polled) / asked_per_s() * 1e-6
