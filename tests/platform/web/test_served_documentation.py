"""The built documentation behind `/docs`: for everybody, from its folder alone, and a sentence where there is none."""

import pytest

from boresight.platform.web import static_files


@pytest.fixture
def shelf(tmp_path, monkeypatch):
    """A folder in place of the built site."""
    (tmp_path / "documentation" / "how-to").mkdir(parents=True)
    (tmp_path / "secret.html").write_text("secret")
    for name in ("index.html", "how-to/index.html"):
        (tmp_path / "documentation" / name).write_text(f"<title>{name}</title>")
    monkeypatch.setattr(static_files, "folder", lambda name: tmp_path / name)
    return tmp_path


@pytest.mark.usefixtures("shelf")
@pytest.mark.parametrize(
    ("address", "title"),
    [("/docs", "index.html"), ("/docs/", "index.html"), ("/docs/how-to/", "how-to/index.html")],
)
def test_the_console_shows_it_to_everybody(house, address, title):
    answer = house.anybody().get(address, follow_redirects=True)
    assert (answer.status_code, answer.text) == (200, f"<title>{title}</title>")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"


@pytest.mark.usefixtures("shelf")
@pytest.mark.parametrize("name", ["nothing.html", "..%2fsecret.html", "how-to", "%00"])
def test_what_is_no_page_of_it_is_not_found(house, name):
    assert house.anybody().get(f"/docs/{name}").status_code == 404


def test_where_it_was_not_built_a_sentence_says_how_to_get_it(house, monkeypatch):
    def refuse(name):
        raise FileNotFoundError(name)

    monkeypatch.setattr(static_files, "folder", refuse)
    answer = house.anybody().get("/docs/")
    assert answer.status_code == 404
    assert "make docs" in answer.text
