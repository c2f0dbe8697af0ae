"""Who asks, how a request is sent, and whether its answer is one that the OpenAPI document knows: the judge is schemathesis."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import requests
from schemathesis import APIOperation, Case, Response
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.served import PASSWORD

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
UNAVAILABLE = 503  # documented, but here nothing is overloaded: it would be a failure that hides
LONGEST_WAIT_S = 60
SHOWN = 1500


@dataclass
class Asker:
    """An identity; one that lost its log-in logs in again, so that a run cannot end by shutting itself out.

    Parameters
    ----------
    name
        Log-in name; None is nobody.
    """

    address: str
    name: str | None
    session: requests.Session = field(default_factory=requests.Session)
    log_ins: int = 0

    def log_in(self) -> None:
        self.session.close()
        self.session = requests.Session()
        if self.name is None:
            return
        credentials = {"name": self.name, "password": PASSWORD}
        answer = self.session.post(f"{self.address}/api/v1/sessions", json=credentials, timeout=LONGEST_WAIT_S)
        answer.raise_for_status()
        self.session.headers["X-CSRF-Token"] = answer.json()["csrf_token"]
        self.log_ins += 1

    def send(self, request: dict[str, Any], *, whole: bool = True) -> requests.Response:
        own = {"authorization", "x-csrf-token", "cookie"} if self.name else {"cookie"}
        headers = {name: value for name, value in (request.get("headers") or {}).items() if name.lower() not in own}
        sent = {**request, "headers": headers, "timeout": LONGEST_WAIT_S, "allow_redirects": False, "stream": not whole}
        sent.pop("cookies", None)
        answer = self.session.request(**sent)
        if answer.status_code == 401 and self.name is not None:
            self.log_in()
            answer = self.session.request(**sent)
        return answer


@dataclass
class Tally:
    requests: int = 0
    unsendable: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    by_asker: Counter[str] = field(default_factory=Counter)
    by_kind: Counter[str] = field(default_factory=Counter)
    operations: set[str] = field(default_factory=set)
    server_errors: list[str] = field(default_factory=list)
    undocumented: list[str] = field(default_factory=list)

    def judge(self, kind: str, asker: Asker, case: Case, request: dict[str, Any], answer: requests.Response) -> None:
        self.requests += 1
        self.statuses[answer.status_code] += 1
        self.by_asker[asker.name or "anonymous"] += 1
        self.by_kind[kind] += 1
        self.operations.add(case.operation.label)
        told = f"{case.operation.label} as {asker.name}: {answer.status_code}"
        if answer.status_code >= 500 and not case.operation.path.startswith("/readyz"):
            self.server_errors.append(f"{told}\n{_told(request)}\n{answer.text[:SHOWN]}")
        for failure in _failures(case, answer):
            self.undocumented.append(f"{told} {failure}\n{_told(request)}")

    @property
    def failures(self) -> list[str]:
        return [*self.server_errors, *self.undocumented]

    def summary(self) -> dict[str, Any]:
        return {
            "requests": self.requests,
            "operations": len(self.operations),
            "server_errors": len(self.server_errors),
            "undocumented_answers": len(self.undocumented),
            "by_asker": dict(self.by_asker),
            "by_kind": dict(self.by_kind),
            "by_status": {str(status): count for status, count in sorted(self.statuses.items())},
        }


def _failures(case: Case, answer: requests.Response) -> list[str]:
    if answer.headers.get("content-type", "").startswith("text/event-stream"):
        return []  # endless: its status and type are all there is to see
    try:
        case.validate_response(Response.from_requests(answer, verify=False), checks=CHECKS)
    except FailureGroup as group:
        return [f"{type(one).__name__}: {one}"[:SHOWN] for one in group.exceptions]
    except Failure as failure:
        return [f"{type(failure).__name__}: {failure}"[:SHOWN]]
    return []


def _told(request: dict[str, Any]) -> str:
    return repr({name: value for name, value in request.items() if name != "timeout"})[:SHOWN]


def bare_case(operation: APIOperation, **given: Any) -> Case:
    return operation.Case(method=operation.method.upper(), **given)
