"""A stand-in for OpenC3 COSMOS 7: the JSON-RPC methods and storage addresses of its published API that are used here.

Rows have the form that `questdb_client.py` of openc3 7.4.1 gives them: [value, limits state], and one row alone without its list.
"""

import base64
import datetime as dt

from starlette.applications import Starlette
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

TOKEN = "a-token-of-openc3"


class OpenC3StandIn:
    """Packets by target and name, each a list of (time, items); files by their place in the configuration bucket."""

    def __init__(self, password=""):
        self.password, self.packets, self.files = password, {}, {}
        routes = [
            ("/openc3-api/auth/verify", self.verify, "POST"),
            ("/openc3-api/api", self.call, "POST"),
            ("/openc3-api/storage/upload/{place:path}", self.sign, "GET"),
            ("/openc3-api/storage/download_file/{place:path}", self.download, "GET"),
            ("/files/{place:path}", self.put, "PUT"),
        ]
        self.app = Starlette(routes=[Route(path, do, methods=[how]) for path, do, how in routes])

    def _is_refused(self, request):
        return bool(self.password) and request.headers.get("authorization") != TOKEN

    async def verify(self, request):
        given = await request.json()
        return PlainTextResponse(TOKEN) if given["password"] == self.password else Response(status_code=401)

    async def call(self, request):
        given = await request.json()
        assert given["keyword_params"]["scope"] == "DEFAULT"
        if self._is_refused(request):
            return JSONResponse(
                {"jsonrpc": "2.0", "id": given["id"], "error": {"code": 401, "message": "Unauthorized"}}, 401
            )
        named = {name: value for name, value in given["keyword_params"].items() if name != "scope"}
        result = getattr(self, given["method"])(*given["params"], **named)
        return JSONResponse({"jsonrpc": "2.0", "id": given["id"], "result": result})

    def get_tlm_available(self, items):
        return [item.replace("CONVERTED", "RAW") if self._has(*item.split("__")[:3]) else None for item in items]

    def _has(self, target, packet, item):
        return any(item in values for _, values in self.packets.get((target, packet), ()))

    def get_tlm_values(self, items, start_time=None, end_time=None):
        start, stop = (dt.datetime.fromisoformat(one) for one in (start_time, end_time))
        target, packet = items[0].split("__")[:2]
        names = [item.split("__")[2] for item in items]
        found = [
            [
                [f"{at:%Y-%m-%dT%H:%M:%S.%f}Z" if name == "PACKET_TIMEFORMATTED" else values.get(name), None]
                for name in names
            ]
            for at, values in self.packets[target, packet]
            if start <= at < stop
        ]
        return {} if not found else found[0] if len(found) == 1 else found

    async def sign(self, request):
        if self._is_refused(request):
            return JSONResponse({"status": "error", "message": "Unauthorized"}, 401)
        return JSONResponse({"url": f"/files/{request.path_params['place']}?signature=1", "method": "PUT"}, 201)

    async def put(self, request):
        self.files[request.path_params["place"]] = await request.body()
        return Response(status_code=200)

    async def download(self, request):
        place = request.path_params["place"]
        if place not in self.files:
            return JSONResponse({"status": "error", "message": f"File not found: {place}"}, 404)
        return JSONResponse({"filename": place, "contents": base64.encodebytes(self.files[place]).decode()})
