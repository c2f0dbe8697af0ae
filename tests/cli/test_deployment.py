"""The compose file, the image and the page on deployment say one thing, and only what the commands can do."""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import click
import pytest
import yaml

from boresight.cli import main
from boresight.settings import SETTINGS

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
IMAGE = (ROOT / "Dockerfile").read_text()
PAGE = (ROOT / "docs" / "deployment.md").read_text()
OURS = ("scheduler", "worker", "server")


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def words_of(service: str) -> list[str]:
    return COMPOSE["services"][service]["command"]


def told() -> dict[str, list[str]]:
    return {words[1]: words for block in blocks("sh service") for words in [shlex.split(block)]}


def every_command() -> list[list[str]]:
    lines = [line for kind in ("sh", "sh service") for block in blocks(kind) for line in block.splitlines()]
    lines += re.findall(r"^ExecStart=\S*/(boresight .*)$", PAGE, re.MULTILINE)
    lines += [line.rpartition(" server ")[2] for line in PAGE.splitlines() if line.startswith("$ docker compose run")]
    shown = [shlex.split(line.partition(" < ")[0]) for line in lines if line.startswith("boresight ")]
    (last,) = re.findall(r"^CMD (\[.*\])$", IMAGE, re.MULTILINE)
    return [*shown, *map(words_of, OURS), yaml.safe_load(last)]


@pytest.mark.parametrize("words", every_command(), ids=" ".join)
def test_every_command_that_is_shown_is_one_with_options_that_there_are(words):
    command, rest = main, words[1:]
    while isinstance(command, click.Group):
        command, rest = command.commands[rest[0]], rest[1:]
    command.make_context(" ".join(words), list(rest))  # refuses an unknown option, or a value that it cannot take


def test_the_compose_file_starts_what_the_plain_commands_start():
    names = {"scheduler": "scheduler", "worker": "worker", "server": "serve"}
    assert {names[service] for service in OURS} == set(told())
    for service in OURS:
        options = dict(zip(words_of(service)[2::2], words_of(service)[3::2], strict=True))
        plain = told()[names[service]]
        assert options.keys() == dict(zip(plain[2::2], plain[3::2], strict=True)).keys()
        assert options.get("--port") == dict(zip(plain[2::2], plain[3::2], strict=True)).get("--port")


def test_everything_starts_again_and_nobody_runs_as_root():
    assert all(service["restart"] == "unless-stopped" for service in COMPOSE["services"].values())
    assert re.findall(r"^USER (.*)$", IMAGE, re.MULTILINE) == ["boresight"]
    assert all(COMPOSE["services"][name]["cap_drop"] == ["ALL"] for name in OURS)
    assert "Restart=always" in PAGE


def test_what_must_last_lies_in_volumes_and_all_who_compute_see_one_folder_under_one_path():
    mounts = {tuple(COMPOSE["services"][name]["volumes"]) for name in OURS}
    ((mount,),) = mounts
    volume, _, path = mount.partition(":")
    assert {volume, COMPOSE["services"]["database"]["volumes"][0].partition(":")[0]} == set(COMPOSE["volumes"])
    assert f"BORESIGHT_DATA_FOLDER={path}\n" in IMAGE


def test_only_the_server_is_published_and_only_to_this_machine():
    published = {name: service["ports"] for name, service in COMPOSE["services"].items() if "ports" in service}
    inner = {name for name, network in COMPOSE["networks"].items() if network.get("internal")}
    assert published == {"server": ["127.0.0.1:8000:8000"]}
    assert {name for service in ("scheduler", "database") for name in COMPOSE["services"][service]["networks"]} <= inner


def test_workers_reach_an_object_store_outside_by_a_network_that_nobody_else_is_on():
    inner = {name for name, network in COMPOSE["networks"].items() if network.get("internal")}
    (way_out,) = set(COMPOSE["services"]["worker"]["networks"]) - inner
    assert [name for name, service in COMPOSE["services"].items() if way_out in service["networks"]] == ["worker"]


def test_every_link_between_services_is_encrypted_and_asks_both_ends_who_they_are():
    for name in OURS:
        given = COMPOSE["services"][name]["environment"]
        assert given.keys() >= {"BORESIGHT_TLS_AUTHORITY", "BORESIGHT_TLS_CERTIFICATE"}
        assert given.get("BORESIGHT_SCHEDULER", "tls://scheduler:8786") == "tls://scheduler:8786"
    assert "BORESIGHT_CLUSTER_NETWORK_CLOSED" not in str(COMPOSE)
    assert set(re.findall(r"BORESIGHT_SCHEDULER=(\w+)://", PAGE)) == {"tls"}


def test_no_service_takes_all_memory_or_all_processes():
    for service in COMPOSE["services"].values():
        assert re.fullmatch(r"\$\{[A-Z]+_MEMORY:-\d+g\}", service["mem_limit"])
        assert 0 < service["pids_limit"] <= 512


def test_every_service_is_looked_after_and_has_as_long_to_end_as_its_unit():
    (seconds,) = re.findall(r"^TimeoutStopSec=(\d+)$", PAGE, re.MULTILINE)
    assert all("healthcheck" in service for service in COMPOSE["services"].values())
    assert {COMPOSE["services"][name]["stop_grace_period"] for name in OURS} == {f"{seconds}s"}


def test_the_health_check_of_a_worker_looks_for_the_port_of_its_scheduler():
    asked = COMPOSE["services"]["worker"]["healthcheck"]["test"][3]
    port = COMPOSE["services"]["worker"]["environment"]["BORESIGHT_SCHEDULER"].rpartition(":")[2]
    assert asked == f":{int(port):04X} 01 "


def test_no_secret_stands_in_the_compose_file_and_workers_get_none():
    secrets = {
        f"{name}.{key}": value
        for name, service in COMPOSE["services"].items()
        for key, value in service.get("environment", {}).items()
        if "PASSWORD" in key
    }
    assert set(secrets) == {"database.POSTGRES_PASSWORD", "server.PGPASSWORD"}
    assert all(value.startswith("${BORESIGHT_DATABASE_PASSWORD:?") for value in secrets.values())


def test_every_setting_that_is_given_is_one():
    given = {key for service in COMPOSE["services"].values() for key in service.get("environment", {})}
    given |= set(re.findall(r"^export (\w+)=", PAGE, re.MULTILINE)) | set(
        re.findall(r"`(BORESIGHT_\w+)(?:=.*?)?`", PAGE)
    )
    assert {key for key in given if key.startswith("BORESIGHT_")} <= {setting.variable for setting in SETTINGS}


def test_the_image_installs_a_database_driver_by_version_and_hash(tmp_path):
    (line,) = re.findall(r"^RUN (awk .*) \\$", IMAGE, re.MULTILINE)
    shutil.copy(ROOT / "requirements-dev.lock", tmp_path)
    subprocess.run(["sh", "-c", line], check=True, cwd=tmp_path)
    chosen = (tmp_path / "requirements-site.lock").read_text()
    names = set(re.findall(r"^([a-z0-9-]+)==", chosen, re.MULTILINE))
    assert {"psycopg", "psycopg-binary"} <= names <= {"psycopg", "psycopg-binary", "obstore"}
    assert chosen.count("--hash=sha256:") >= len(names)


def test_the_image_holds_everything_that_the_wheel_is_made_of():
    project = (ROOT / "pyproject.toml").read_text()
    included = re.findall(r'^"(\w+)" = "boresight/', project, re.MULTILINE)
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {name for line in re.findall(r"^COPY (.*) \S+$", IMAGE, re.MULTILINE) for name in line.split()}
    assert {*included, "backend"} <= copied == let_in


def test_docker_itself_accepts_the_compose_file():
    asked = ["docker", "compose", "version"]
    if shutil.which("docker") is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no docker compose on this machine")
    environment = {"BORESIGHT_DATABASE_PASSWORD": "of-a-test", "PATH": "/usr/bin:/bin:/usr/local/bin"}
    words = ["docker", "compose", "config", "--quiet"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
