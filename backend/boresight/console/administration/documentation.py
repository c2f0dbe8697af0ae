"""The API's documentation as one page made on the server from the OpenAPI document: no script, no other host."""

from __future__ import annotations

import re
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from fastapi import APIRouter
from jinja2 import Environment, FileSystemLoader
from markupsafe import Markup, escape
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response

FOLDER = Path(__file__).resolve().parent / "documentation_page"

router = APIRouter(include_in_schema=False)


@lru_cache(maxsize=1)
def _environment() -> Environment:
    """Build the environment; what an OpenAPI document leaves out is simply not shown."""
    loader = FileSystemLoader(FOLDER)
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


@router.get("/docs", name="documentation")
def documentation(request: Request) -> HTMLResponse:
    """Show every operation with its parameters, bodies and refusals."""
    return HTMLResponse(_environment().get_template("page.html").render(**_content(request.app.openapi())))


@router.get("/api/v1/docs", name="documentation_of_version")
def documentation_of_version() -> RedirectResponse:
    """Lead to the page from beside the routes that it documents."""
    return RedirectResponse("/docs")


@router.get("/docs/style.css", name="documentation_style")
def documentation_style() -> Response:
    """Send the page's style."""
    return Response((FOLDER / "style.css").read_text(), media_type="text/css")


def _content(openapi: dict[str, Any]) -> dict[str, Any]:
    """Arrange the OpenAPI document for the page: operations by tag, shapes by name."""
    operations = [
        {"method": method.upper(), "path": path, **operation}
        for path, methods in openapi["paths"].items()
        for method, operation in methods.items()
    ]
    groups = [
        {**tag, "operations": [operation for operation in operations if tag["name"] in operation.get("tags", ())]}
        for tag in openapi["tags"]
    ]
    shapes = openapi["components"]["schemas"]
    return {
        "info": openapi["info"],
        "groups": groups,
        "shapes": sorted(shapes.items()),
        "type_of": type_of,
        "shape": _linked,
        "prose": _prose,
        "example_of": partial(example_of, shapes=shapes),
    }


def _prose(text: str) -> Markup:
    """Set the two marks that the descriptions use: `code` and **strong**."""
    marked = re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text)))
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", marked))  # noqa: S704 - escaped above


def _linked(schema: dict[str, Any]) -> Markup:
    """Say a schema, with a link where it is a named shape."""
    words = type_of(schema)
    named = re.fullmatch(r"(list of )?([A-Z]\w*)", words)
    if named is None:
        return escape(words)
    return Markup('{}<a href="#shape-{}">{}</a>').format(named[1] or "", named[2], named[2])


def type_of(schema: dict[str, Any]) -> str:
    """Say a JSON schema in a few words; a named shape by its name."""
    if "$ref" in schema:
        return str(schema["$ref"]).rsplit("/", 1)[-1]
    if "anyOf" in schema:
        return " or ".join(type_of(choice) for choice in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return " | ".join(str(value) for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        return f"list of {type_of(schema.get('items', {}))}"
    return str(schema.get("type", "anything"))


def example_of(schema: dict[str, Any], shapes: dict[str, Any]) -> Any:
    """Return the example that a body or the members of its shape declare; None where they declare none."""
    if "$ref" in schema:
        schema = shapes[type_of(schema)]
    if schema.get("examples"):
        return schema["examples"][0]
    members = {
        name: member["examples"][0] for name, member in schema.get("properties", {}).items() if member.get("examples")
    }
    return members or None
