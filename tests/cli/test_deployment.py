"""What an administrator starts: image and compose file, `worker`, `scheduler` and `serve` with their refusals."""

from __future__ import annotations

import re
import shlex
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml

import boresight
from benchmarks.servers import free_port
from boresight.cli import main
from boresight.settings import SETTINGS
from tests.cli.conftest import assert_refused

ROOT = Path(__file__).resolve().parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
IMAGE = (ROOT / "Dockerfile").read_text()
KUBERNETES_PAGE = (ROOT / "docs" / "how-to" / "run-on-kubernetes.md").read_text()
PAGE = (ROOT / "docs" / "deployment.md").read_text()
OURS = ("scheduler", "worker", "server")


FOLDER = ROOT / "deployment" / "kubernetes"
MANIFESTS = {path.name: list(yaml.safe_load_all(path.read_text())) for path in sorted(FOLDER.glob("*.yaml"))}


def every(kind: str) -> dict[str, dict]:
    found = [one for documents in MANIFESTS.values() for one in documents if one["kind"] == kind]
    return {one["metadata"]["name"]: one for one in found}


PODS = {name: one["spec"]["template"] for kind in ("Deployment", "StatefulSet") for name, one in every(kind).items()}


def pod(name: str) -> dict:
    return PODS[name]["spec"]


def container(name: str) -> dict:
    (only,) = pod(name)["containers"]
    return only


def given(name: str) -> dict[str, object]:
    return {one["name"]: one.get("value", one.get("valueFrom")) for one in container(name)["env"]}


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def split_command(service: str) -> list[str]:
    return COMPOSE["services"][service]["command"]


def told() -> dict[str, list[str]]:
    return {words[1]: words for block in blocks("sh service") for words in [shlex.split(block)]}


def every_command() -> list[list[str]]:
    lines = [line for kind in ("sh", "sh service") for block in blocks(kind) for line in block.splitlines()]
    lines += re.findall(r"^ExecStart=\S*/(boresight .*)$", PAGE, re.MULTILINE)
    lines += [line.rpartition(" server ")[2] for line in PAGE.splitlines() if line.startswith("$ docker compose run")]
    shown = [shlex.split(line.partition(" < ")[0]) for line in lines if line.startswith("boresight ")]
    (last,) = re.findall(r"^CMD (\[.*\])$", IMAGE, re.MULTILINE)
    return [*shown, *map(split_command, OURS), yaml.safe_load(last)]


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
        options = dict(zip(split_command(service)[2::2], split_command(service)[3::2], strict=True))
        plain = told()[names[service]]
        assert options.keys() == dict(zip(plain[2::2], plain[3::2], strict=True)).keys()
        assert options.get("--port") == dict(zip(plain[2::2], plain[3::2], strict=True)).get("--port")


def test_everything_starts_again_and_nobody_runs_as_root():
    assert all(service["restart"] == "unless-stopped" for service in COMPOSE["services"].values())
    assert re.findall(r"^USER (.*)$", IMAGE, re.MULTILINE) == ["boresight"]
    assert all(service["cap_drop"] == ["ALL"] for service in COMPOSE["services"].values())
    assert all(service["read_only"] for service in COMPOSE["services"].values())
    assert COMPOSE["services"]["database"]["user"] == "999:999"
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
    assert {pod(name)["terminationGracePeriodSeconds"] for name in OURS} == {int(seconds)}
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
    given |= {one["name"] for name in PODS for one in container(name)["env"]}
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
    last = IMAGE.rpartition("\nFROM ")[2]
    taken, of_server = (
        {name for line in re.findall(r"^COPY (?!--from)(.*) \S+$", text, re.MULTILINE) for name in line.split()}
        for text in (IMAGE, last)
    )
    assert {*included, "backend", "docs/glossary.md"} <= of_server
    assert taken - {"docs/glossary.md"} == let_in  # of the folder `docs`
    assert "COPY --from=documentation" in last


def test_the_manifests_start_what_the_compose_file_starts_and_kustomize_takes_them_all():
    (whole,) = MANIFESTS["kustomization.yaml"]
    assert set(whole["resources"]) == MANIFESTS.keys() - {"kustomization.yaml"}
    assert set(PODS) == set(COMPOSE["services"])
    assert whole["images"] == [{"name": "boresight", "newTag": boresight.__version__}]
    for name in OURS:
        assert container(name)["command"] == split_command(name)
        environment = COMPOSE["services"][name]["environment"]
        assert environment.keys() <= given(name).keys()
        assert given(name).get("BORESIGHT_SCHEDULER") == environment.get("BORESIGHT_SCHEDULER")
        assert container(name)["image"] == "boresight"
    assert (
        container("worker")["readinessProbe"]["exec"]["command"]
        == COMPOSE["services"]["worker"]["healthcheck"]["test"][1:]
    )
    assert container("database")["image"] == COMPOSE["services"]["database"]["image"]


@pytest.mark.parametrize("name", PODS)
def test_a_pod_runs_as_nobody_in_particular_with_limits_and_is_asked_whether_it_works(name):
    of_pod, only = pod(name)["securityContext"], container(name)
    assert (of_pod["runAsNonRoot"], of_pod["runAsUser"] > 0) == (True, True)
    assert of_pod["seccompProfile"] == {"type": "RuntimeDefault"}
    assert pod(name)["automountServiceAccountToken"] is False
    assert only["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert set(only["resources"]) == {"requests", "limits"}
    assert all(set(amounts) == {"cpu", "memory"} for amounts in only["resources"].values())
    assert "readinessProbe" in only
    assert f"useradd --system --uid {pod('server')['securityContext']['runAsUser']} " in IMAGE
    selected = [
        one["spec"]["selector"]["matchLabels"] for kind in ("Deployment", "StatefulSet") for one in every(kind).values()
    ]
    assert PODS[name]["metadata"]["labels"] in selected


def test_all_pods_that_compute_mount_one_folder_and_passwords_come_from_secrets_to_those_who_need_them():
    for name in OURS:
        mounts = {one["name"]: one["mountPath"] for one in container(name)["volumeMounts"]}
        assert f"BORESIGHT_DATA_FOLDER={mounts['data']}\n" in IMAGE
        volumes = {one["name"]: one for one in pod(name)["volumes"]}
        assert mounts.keys() == volumes.keys()
        assert volumes["data"]["persistentVolumeClaim"] == {"claimName": "data"}
    mounts = {one["mountPath"]: one["name"] for one in container("server")["volumeMounts"]}
    assert mounts[str(Path(given("server")["BORESIGHT_BACKUP_KEY"]).parent)] == "backup"
    assert "create secret generic backup --from-literal backup.key=" in KUBERNETES_PAGE
    assert every("PersistentVolumeClaim")["data"]["spec"]["accessModes"] == ["ReadWriteMany"]
    secrets = {(name, key): value for name in PODS for key, value in given(name).items() if "PASSWORD" in key}
    reference = {"secretKeyRef": {"name": "database", "key": "password"}}
    assert secrets == {("database", "POSTGRES_PASSWORD"): reference, ("server", "PGPASSWORD"): reference}


def test_a_pod_is_reached_by_whom_it_serves_and_a_server_is_replaced_while_another_answers():
    policies = every("NetworkPolicy")
    assert policies["nobody"]["spec"] == {"podSelector": {}, "policyTypes": ["Ingress"]}
    who = {
        name: {
            one["podSelector"]["matchLabels"]["app"]
            for rule in policies[name]["spec"]["ingress"]
            for one in rule["from"]
        }
        for name in ("database", "scheduler", "worker")
    }
    assert who == {
        "database": {"server"},
        "scheduler": {"server", "worker"},
        "worker": {"scheduler", "server", "worker"},
    }
    (outside,) = policies["server"]["spec"]["ingress"]
    assert outside["ports"] == [{"port": container("server")["ports"][0]["containerPort"]}]
    server = every("Deployment")["server"]["spec"]
    assert (server["replicas"] > 1, server["strategy"]["rollingUpdate"]["maxUnavailable"]) == (True, 0)
    assert container("server")["readinessProbe"]["httpGet"]["path"] == "/readyz"
    drain_s, probe_s = (
        float(given("server")["BORESIGHT_DRAIN_S"]),
        container("server")["readinessProbe"]["periodSeconds"],
    )
    assert drain_s >= 2 * probe_s  # asked while it drains, and taken out of service before it ends
    assert drain_s < pod("server")["terminationGracePeriodSeconds"] / 2
    assert every("PodDisruptionBudget")["server"]["spec"]["minAvailable"] == 1


def test_docker_itself_accepts_the_compose_file():
    asked = ["docker", "compose", "version"]
    if shutil.which("docker") is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no docker compose on this machine")
    environment = {"BORESIGHT_DATABASE_PASSWORD": "of-a-test", "PATH": "/usr/bin:/bin:/usr/local/bin"}
    words = ["docker", "compose", "config", "--quiet"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr


def test_a_worker_for_nobody_is_refused(boresight, monkeypatch):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "")
    assert_refused(boresight("worker"), "--scheduler tcp://host:port", code="no-scheduler")


@pytest.mark.parametrize("command", ["worker", "scheduler", "serve"])
@pytest.mark.parametrize(
    "address",
    ["foo", "127.0.0.1:8786", "http://127.0.0.1:8786", "tcp://:99999", "tcp://:8786", "tcp://host", "tcp://h:0"],
)
def test_what_is_no_address_of_a_scheduler_is_refused_by_all_who_use_one(boresight, monkeypatch, command, address):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", address)
    done = boresight(command, "--port", free_port()) if command != "worker" else boresight(command)

    assert_refused(done, f"BORESIGHT_SCHEDULER={address!r} ", "tcp://host:port", code="not-an-address")


def test_a_scheduler_that_is_to_be_encrypted_does_not_open_a_plain_link(boresight, monkeypatch):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "tls://127.0.0.1:8786")
    done = boresight("scheduler", "--port", free_port())

    assert_refused(done, "BORESIGHT_TLS_AUTHORITY", "BORESIGHT_TLS_CERTIFICATE", code="no-certificates")


def test_a_worker_on_an_encrypted_link_without_certificates_is_refused(boresight):
    done = boresight("worker", "--scheduler", "tls://127.0.0.1:8786")

    assert_refused(done, "BORESIGHT_TLS_AUTHORITY", "BORESIGHT_TLS_CERTIFICATE", code="no-certificates")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "10.1.2.3"])  # noqa: S104 - what is to be refused
def test_a_plain_scheduler_that_others_would_reach_is_refused_unless_its_network_is_closed(
    boresight, monkeypatch, host
):
    done = boresight("scheduler", "--host", host, "--port", free_port())

    assert_refused(done, "BORESIGHT_TLS_AUTHORITY", "BORESIGHT_CLUSTER_NETWORK_CLOSED=1")

    async def listen(*_):
        raise OSError(98, "it would have listened")

    monkeypatch.setenv("BORESIGHT_CLUSTER_NETWORK_CLOSED", "1")
    monkeypatch.setattr("boresight.workers.service._scheduler", listen)
    assert "it would have listened" in boresight("scheduler", "--host", host, "--port", free_port()).stderr


@pytest.mark.parametrize("words", [("worker",), ("serve", "--port", "1")])
def test_a_plain_scheduler_beyond_this_machine_is_refused_by_all_who_use_one(boresight, monkeypatch, words):
    monkeypatch.setenv("BORESIGHT_SCHEDULER", "tcp://10.1.2.3:8786")
    words = (*words[:-1], free_port()) if words[0] == "serve" else words
    done = boresight(*words)

    assert_refused(
        done,
        "BORESIGHT_SCHEDULER=tcp://10.1.2.3:8786 ",
        "BORESIGHT_CLUSTER_NETWORK_CLOSED=1",
    )


def test_certificates_are_made_for_their_owner_only_and_never_replaced(boresight, tmp_path):
    done = boresight("certificates", tmp_path / "made")
    files = {path.name: path.read_text() for path in (tmp_path / "made").iterdir()}

    assert done.exit_code == 0
    assert set(files) == {"authority.pem", "boresight.pem"}
    assert all(path.stat().st_mode & 0o077 == 0 for path in (tmp_path / "made", *(tmp_path / "made").iterdir()))
    assert "PRIVATE KEY" in files["boresight.pem"]
    assert "PRIVATE KEY" not in files["authority.pem"] + done.output
    assert_refused(boresight("certificates", tmp_path / "made"), "already exists")
    assert {path.name: path.read_text() for path in (tmp_path / "made").iterdir()} == files


def test_a_scheduler_on_a_port_in_use_is_refused():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        words = [sys.executable, "-m", "boresight", "scheduler", "--port", str(port)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)

    assert done.returncode == 1
    assert f"boresight: 127.0.0.1:{port} " in done.stderr
    assert "--port" in done.stderr


def test_a_port_in_use_is_told_however_deep_it_is_wrapped(boresight, monkeypatch):
    async def fail(*_):
        raise RuntimeError("Scheduler failed to start.") from OSError(98, "Address already in use")

    monkeypatch.setattr("boresight.workers.service._scheduler", fail)
    done = boresight("scheduler", "--port", "8786")

    assert_refused(done, "127.0.0.1:8786 ", "(Address already in use)", code="port-in-use")


@pytest.mark.parametrize("words", [("--processes", "0"), ("--memory-gb", "0"), ("--port", "1")])
def test_what_is_no_number_of_processes_or_memory_is_wrong_usage(boresight, words):
    assert boresight("worker", *words).exit_code == 2


def test_a_server_whose_files_have_no_place_is_refused_before_it_says_that_it_is_there(
    boresight, monkeypatch, tmp_path
):
    (tmp_path / "file").touch()
    monkeypatch.setenv("BORESIGHT_BLOBS", f"{tmp_path}/file/blobs")
    done = boresight("serve", "--port", free_port())

    assert_refused(done, f"{tmp_path}/file/blobs ", code="folder-not-writable")
    assert "Boresight on" not in done.output
