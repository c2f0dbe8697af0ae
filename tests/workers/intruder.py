"""Another user of the machine, who tries to run code in Boresight's processes and to read its files.

Reads `{"user": id, "ports": [...], "files": [...], "processes": [...]}` from standard input, becomes that user, and writes a
list of what succeeded. Everything is imported before, for the other user may not be able to read the installation.
"""

import asyncio
import json
import os
import socket
import ssl
import sys
from pathlib import Path

from distributed import Client, Security
from distributed.core import rpc
from distributed.protocol.pickle import dumps

from boresight.workers.security import issue

PATIENCE_S = 4.0


def forged() -> Security:
    made = issue()
    return Security(
        require_encryption=True,
        tls_ca_file=made.authority,
        tls_client_cert=made.certificate,
        tls_client_key=made.key,
        tls_worker_cert=made.certificate,
        tls_worker_key=made.key,
    )


def trusting(security: Security) -> dict:
    arguments = security.get_connection_args("client")
    arguments["ssl_context"].verify_mode = ssl.CERT_NONE
    return arguments


DISGUISES = {
    "tcp": {},
    "tls with dask's self-made certificate": trusting(Security.temporary()),
    "tls with a forged certificate": trusting(forged()),
}


async def run_on_scheduler(port, scheme, arguments):
    client = Client(f"{scheme}://127.0.0.1:{port}", timeout=PATIENCE_S, asynchronous=True, set_as_default=False)
    client.connection_args = arguments or client.connection_args
    async with client:
        return await client.run_on_scheduler(os.getpid)


async def call(port, scheme, arguments, **message):
    remote = rpc(f"{scheme}://127.0.0.1:{port}", connection_args=arguments, timeout=PATIENCE_S)
    try:
        return await getattr(remote, message.pop("op"))(**message)
    finally:
        await remote.close_rpc()


def attempts(port):
    run = {"function": dumps(os.getpid), "args": dumps(()), "kwargs": dumps({})}
    for name, arguments in DISGUISES.items():
        scheme = name[:3]
        yield f"run_on_scheduler by {name}", run_on_scheduler(port, scheme, arguments)
        yield f"run by {name}", call(port, scheme, arguments, op="run", **run)
        yield f"identity by {name}", call(port, scheme, arguments, op="identity")


async def outcome(port, what, attempt):
    try:
        got = await asyncio.wait_for(attempt, 3 * PATIENCE_S)
    except Exception:  # noqa: BLE001 - whatever kept it from getting anything
        return None
    failed = isinstance(got, dict) and got.get("status") == "error"
    return None if failed else [port, what, repr(got)[:200]]


def answer(port, *, encrypted):
    try:
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as plain:
            plain.settimeout(PATIENCE_S)
            context = ssl.create_default_context()
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            link = context.wrap_socket(plain) if encrypted else plain
            link.sendall(b"GET /info/main/workers.html HTTP/1.0\r\n\r\n")
            got = link.recv(1000)
    except OSError:
        return b""
    return b"" if got[:1] == b"\x15" else got  # an alert of TLS: go away


def readable(path):
    try:
        with Path(path).open("rb") as file:
            file.read(1)
    except OSError:
        return False
    return True


async def main(task):
    got = await asyncio.gather(*(outcome(port, *attempt) for port in task["ports"] for attempt in attempts(port)))
    got += [
        [port, f"answered, encrypted: {encrypted}", repr(found)]
        for port in task["ports"]
        for encrypted in (False, True)
        if (found := answer(port, encrypted=encrypted))
    ]
    got += [[path, "read", ""] for path in task["files"] if readable(path)]
    got += [[pid, "environment read", ""] for pid in task["processes"] if readable(f"/proc/{pid}/environ")]
    return [one for one in got if one]


if __name__ == "__main__":
    order = json.load(sys.stdin)
    os.setgroups([])
    os.setgid(order["user"])
    os.setuid(order["user"])
    json.dump(asyncio.run(main(order)), sys.stdout)
