"""The README and the changelog tell what is there and nothing that is not: settings, commands, nouns, contracts, dependencies."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

import boresight
from boresight.calibration.options import OPTIONS, listed
from boresight.cameras import CAMERA_MODELS
from boresight.cli import main
from boresight.console.access.tables import ROLES
from boresight.console.operation import PREFIX
from boresight.console.routes import NOUNS, routers
from boresight.figures import FIGURES
from boresight.settings import SETTINGS
from boresight.telemetry.schema import OPTIONAL_COLUMNS, REQUIRED_COLUMNS

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
STATUSES = ("converged", "max_iterations", "rank_deficient", "diverged", "too_few_stars")
SENSOR_FIELDS = (
    "name", "detector", "rows", "columns", "pixel_pitch_m", "camera_model", "parity", "centroid_sigma_px", "initial",
    "typical_sigma", "free", "magnitude_limit",
)  # fmt: skip


def _commands(group: click.Group, words: tuple[str, ...] = ("boresight",)) -> Iterator[str]:
    for name, command in group.commands.items():
        if isinstance(command, click.Group):
            yield from _commands(command, (*words, name))
        else:
            yield " ".join((*words, name))


def _packages() -> set[str]:
    extras = PROJECT["optional-dependencies"].values()
    return {re.match(r"[A-Za-z0-9-]+", name)[0] for group in (PROJECT["dependencies"], *extras) for name in group}


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting.name)
def test_the_readme_tells_every_setting_as_the_table_has_it(setting):
    default = f"`{setting.default}`" if setting.default else ""
    assert f"| `{setting.variable}` | {default} | {setting.unit} | {setting.sentence} |" in README


def test_the_readme_lists_every_choice_of_a_calibration_as_it_is_declared():
    assert listed() in README


def test_the_readme_names_no_setting_that_does_not_exist():
    named = set(re.findall(r"BORESIGHT_[A-Z_]+", README))
    assert named <= {setting.variable for setting in SETTINGS}


def test_the_readme_names_exactly_the_commands_there_are():
    told = {
        command
        for command in _commands(main)
        if re.search(rf"^\| `{re.escape(command)}[ `]", README, re.MULTILINE)
    }  # fmt: skip
    rows = re.findall(r"^\| `boresight ", README, re.MULTILINE)
    assert told == set(_commands(main))
    assert len(rows) == len(told)


def test_the_readme_names_exactly_the_nouns_of_the_api():
    paths = [route.path for noun in NOUNS for router in routers(noun) for route in router.routes]
    nouns = {"/" + re.split("[/:]", path.removeprefix(PREFIX))[1] for path in paths}
    told = {
        noun for row in re.findall(r"^\| (`/[^|]*) \|", README, re.MULTILINE) for noun in re.findall("`(.*?)`", row)
    }
    assert told == nouns
    assert PREFIX in README


@pytest.mark.parametrize(
    "word",
    [
        *(f"`{name}`" for name in CAMERA_MODELS),
        *(f"`{name}`" for model in CAMERA_MODELS.values() for name in model.parameter_names),
        *(f"`{name}`" for name in FIGURES),
        *(f"`{name}`" for name in (*ROLES, *STATUSES, *SENSOR_FIELDS, *REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)),
    ],
)
def test_the_readme_names_every_word_of_the_contracts(word):
    assert word in README


@pytest.mark.parametrize(
    ("option", "words"), [(name, tuple(OPTIONS[name].words)) for name in ("method", "variant", "match")], ids=str
)
def test_the_readme_names_every_choice_of_a_calibration(option, words):
    (row,) = re.findall(r"^\| `boresight calibrate .*", README, re.MULTILINE)
    assert f"`--{option} {words[0]}`" in row
    assert all(f"`{word}`" in row for word in words[1:])


def test_the_readme_gives_a_reason_for_every_dependency_and_for_no_other():
    told = set(re.findall(r"^\| `([a-z][a-z0-9-]*)` \| .+ \|$", README, re.MULTILINE))
    paragraph = README.partition("For development:")[2].partition("\n\n")[0]
    assert told | set(re.findall(r"`([a-z-]+)`", paragraph)) == _packages()


@pytest.mark.parametrize(
    "folder", sorted(path.name for path in (ROOT / "backend" / "boresight").iterdir() if path.is_dir())
)
def test_the_readme_shows_every_floor_of_the_tree(folder):
    assert folder == "__pycache__" or re.search(rf"^    {folder}/ +\w", README, re.MULTILINE)


def test_what_the_readme_says_happens_somewhere_stands_there():
    section = README.partition("## Where what happens")[2].partition("\n## ")[0]
    for row in re.findall(r"^\| (?!What|--).*$", section, re.MULTILINE):
        words = re.findall(r"`([^`]+)`", row)
        paths = [
            ROOT / ("" if word.startswith("frontend/") else "backend/boresight") / word for word in words if "." in word
        ]
        text = "".join(path.read_text() for path in paths)
        assert [word for word in words if "." not in word and not re.search(rf"\b{word}\b", text)] == []


def test_the_changelog_tells_this_version():
    assert f"\n## {boresight.__version__}\n" in (ROOT / "CHANGELOG.md").read_text()
    assert PROJECT["version"] == boresight.__version__
