"""A stand-in for a Yamcs server: the part of its published HTTP API that is used here, in JSON and protobuf as its clients ask.

What it does was compared with Yamcs 5.12.8 by the tests of this folder, which run against a real server too
(`BORESIGHT_YAMCS_SERVER=http://host:8090`, an instance `sat` with the parameters of `PARAMETERS`, a bucket `boresight`).
"""

import base64
import datetime as dt
import threading
import time
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from yamcs.api import exception_pb2
from yamcs.client.core.helpers import parse_value, split_protobuf_stream
from yamcs.protobuf._vendor.google.protobuf import json_format
from yamcs.protobuf.events import events_pb2, events_service_pb2
from yamcs.protobuf.mdb import mdb_pb2
from yamcs.protobuf.pvalue import pvalue_pb2, pvalue_service_pb2
from yamcs.protobuf.yamcs_pb2 import Value

INSTANCE, BUCKET = "sat", "boresight"
STARS = 12
PARAMETERS = [f"/TRK/STAR{n}_{what}" for n in range(1, STARS + 1) for what in ("ROW", "COL", "ID", "MAG")]
PARAMETERS += [f"/TRK/{name}" for name in ("Q_X", "Q_Y", "Q_Z", "Q_W", "TEMPERATURE")]
PROTO = "application/protobuf"


class YamcsStandIn:
    """What it keeps, and how it is made to fail: `status` for every answer, `truncates`, `flood_mb`, `drip_s`."""

    def __init__(self, accounts=None):
        self.accounts = dict(accounts or {})
        self.rows, self.events, self.objects, self.asked = {}, {}, {}, []
        self.status, self.truncates, self.flood_mb, self.drip_s = None, False, 0, 0.0
        routes = [
            ("/auth/token", self.token, "POST"),
            ("/api/mdb/{instance}/parameters", self.parameters, "GET"),
            ("/api/parameter-values/{instance}/streams/{stream:path}", self.load, "POST"),
            ("/api/archive/{instance}:exportParameterValues", self.export, "GET POST"),
            ("/api/archive/{instance}/parameters/{name:path}", self.history, "GET"),
            ("/api/archive/{instance}/events", self.archive_events, "GET POST"),
            ("/api/storage/buckets/{bucket}/objects/{name:path}", self.object, "GET POST"),
        ]
        self.app = Starlette(routes=[Route(path, self._guarded(do), methods=how.split()) for path, do, how in routes])

    def _guarded(self, endpoint):
        async def answer(request):
            self.asked.append(request.url.path)
            if self.status is not None:
                return self._fail(request, self.status, "made to fail")
            if self.accounts and not request.url.path.startswith("/auth") and not self._is_let_in(request):
                return self._fail(request, 401, "")
            if request.path_params.get("instance", INSTANCE) != INSTANCE:
                return self._fail(request, 404, f"No instance named '{request.path_params['instance']}'")
            return await endpoint(request)

        return answer

    def _is_let_in(self, request):
        tokens = {f"Bearer {_token(name)}" for name in self.accounts}
        return (
            request.headers.get("authorization") in tokens or request.headers.get("x-api-key") in self.accounts.values()
        )

    def _fail(self, request, status, said):
        if PROTO in request.headers.get("accept", ""):
            content = exception_pb2.ExceptionMessage(type="NotFoundException", msg=said).SerializeToString()
            return Response(content, status, media_type=PROTO)
        return JSONResponse({"code": status, "type": "NotFoundException", "msg": said}, status)

    def _message(self, request, message):
        if PROTO in request.headers.get("accept", ""):
            return Response(message.SerializeToString(), media_type=PROTO)
        return Response(json_format.MessageToJson(message), media_type="application/json")

    async def _read(self, request, message):
        if PROTO in request.headers.get("content-type", ""):
            message.ParseFromString(await request.body())
            return message
        return json_format.Parse(await request.body(), message)

    async def token(self, request):
        form = await request.form()
        if self.accounts.get(form["username"]) != form["password"]:
            return Response("", 401)
        token = _token(form["username"])
        return JSONResponse({"access_token": token, "refresh_token": token, "expires_in": 3600})

    async def parameters(self, request):
        system, begin = request.query_params.get("system", "/"), int(request.query_params.get("next", 0))
        names = sorted(name for name in PARAMETERS if name.rpartition("/")[0] == system)
        page = min(int(request.query_params.get("limit", 100)), 50)
        found = mdb_pb2.ListParametersResponse(totalSize=len(names))
        for name in names[begin : begin + page]:
            found.parameters.add(name=name.rpartition("/")[2], qualifiedName=name)
        if begin + page < len(names):
            found.continuationToken = str(begin + page)
        return self._message(request, found)

    async def load(self, request):
        stream = split_protobuf_stream([await request.body()], pvalue_service_pb2.LoadParameterValuesRequest)
        count = 0
        for update in (one for message in stream for one in message.values):
            at = update.generationTime.ToDatetime(dt.UTC).replace(
                microsecond=update.generationTime.nanos // 10**6 * 1000
            )
            self.put(at, {update.parameter: parse_value(update.value)})
            count += 1
        return self._message(request, pvalue_service_pb2.LoadParameterValuesResponse(valueCount=count))

    def put(self, at, values):
        """Archive values; Yamcs keeps milliseconds."""
        self.rows.setdefault(at, {}).update(values)

    async def export(self, request):
        given = pvalue_service_pb2.ExportParameterValuesRequest()
        if request.method == "POST":
            await self._read(request, given)
        else:
            query = {name: value for name, value in request.query_params.items() if name in {"start", "stop", "source"}}
            json_format.ParseDict({**query, "parameters": request.query_params.getlist("parameters")}, given)
        names = list(given.parameters)
        for name in names:
            if name not in PARAMETERS:
                return self._fail(request, 404, f"No parameter named {name}")
        start, stop = given.start.ToDatetime(dt.UTC), given.stop.ToDatetime(dt.UTC)
        lines = ["\t".join(["Time", *(name.rpartition("/")[2] for name in names)])]
        for at, values in sorted(self.rows.items()):
            if start <= at < stop and any(name in values for name in names):
                cells = (str(values[name]) if name in values else "" for name in names)
                lines.append("\t".join([f"{at:%Y-%m-%dT%H:%M:%S}.{at.microsecond // 1000:03}Z", *cells]))
        return StreamingResponse(self._pieces("\n".join([*lines, ""]).encode()), media_type="text/csv")

    def _pieces(self, content):
        for _ in range(self.flood_mb):
            yield b"\t" * 1_000_000
        if self.drip_s:
            time.sleep(self.drip_s)
        if self.truncates:
            yield content[: len(content) // 2]
            raise RuntimeError("cut off")
        yield content

    async def history(self, request):
        name = request.path_params["name"]
        found = pvalue_service_pb2.ListParameterHistoryResponse()
        start, stop = (dt.datetime.fromisoformat(request.query_params[one]) for one in ("start", "stop"))
        for at, values in sorted(self.rows.items()):
            if start <= at < stop and name in values:
                value = pvalue_pb2.ParameterValue(engValue=Value(type=Value.DOUBLE, doubleValue=values[name]))
                value.id.name = name
                value.generationTime.FromDatetime(at)
                found.parameter.append(value)
        return self._message(request, found)

    async def archive_events(self, request):
        if request.method == "GET":
            found = events_service_pb2.ListEventsResponse(event=list(self.events.values()))
            return self._message(request, found)
        given = await self._read(request, events_service_pb2.CreateEventRequest())
        event = events_pb2.Event(
            source=given.source,
            generationTime=given.time,
            seqNumber=given.sequenceNumber,
            type=given.type,
            message=given.message,
            severity=events_pb2.Event.EventSeverity.Value(given.severity.upper()),
            extra=dict(given.extra),
        )
        self.events.setdefault((given.time.ToJsonString(), given.source, given.sequenceNumber), event)
        return self._message(request, event)

    async def object(self, request):
        bucket, name = request.path_params["bucket"], request.path_params["name"]
        if bucket != BUCKET or (request.method == "GET" and name not in self.objects):
            return self._fail(request, 404, "Resource not found")
        if request.method == "GET":
            return Response(self.objects[name], media_type="application/octet-stream")
        if request.headers["content-type"].startswith("multipart/"):
            async with request.form() as form:
                self.objects[name] = await form[name].read()
        else:
            self.objects[name] = await request.body()
        return Response("", 200)


def _token(name):
    return base64.b64encode(name.encode()).decode()


@contextmanager
def serving(app):
    """Serve an application on a free port of this machine."""
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="critical", ws="none"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.01)
    try:
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join(10)
