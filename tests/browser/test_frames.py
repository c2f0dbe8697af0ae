"""The frame browser in a real browser: steps, scale, keys and Back keep address and drawing together; numbers are the API's."""

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser


def test_a_frame_is_stepped_through_scaled_and_found_again_by_its_address(people, batch_run):
    with people.seat("analyst") as window:
        window.open(f"/runs/{batch_run}?part=frames&frame=5&scale=100")
        page = window.page
        heading, drawing = page.get_by_role("heading", level=2, name="Frame"), page.locator(".frame-drawing")
        expect(heading).to_have_text("Frame 5")

        page.locator("[data-frame-link=next]").click()
        expect(heading).to_have_text("Frame 6")
        expect(page.locator("[data-frame-link=next]")).to_be_focused()
        drawing.focus()
        page.keyboard.press("ArrowRight")
        expect(heading).to_have_text("Frame 7")
        expect(drawing).to_be_focused()
        assert page.url.endswith("frame=7&scale=100")

        page.get_by_label("Drawn").select_option("500")
        assert page.url.endswith("frame=7&scale=500")
        frame = window.read(f"/api/v1/runs/{batch_run}/frames/7")
        star = next(star for star in frame["exposures"][0]["stars"] if star["new"])
        line = page.locator(f"g[data-star='{star['row']}'] line.new")
        drawn = [float(line.get_attribute(name)) for name in ("x1", "y1", "x2", "y2")]
        d_row, d_col = star["new"]["d_px"]
        assert drawn[2:] == pytest.approx([drawn[0] + 500 * d_col, drawn[1] + 500 * d_row])

        page.locator(f"table.frame-stars tr[data-star='{star['row']}']").hover()
        expect(page.locator(f"g[data-star='{star['row']}']")).to_have_class("star used is-shown")
        page.go_back()
        expect(heading).to_have_text("Frame 6")
        page.get_by_label("Frame", exact=True).fill("4000")
        page.keyboard.press("Enter")
        expect(page.get_by_text("The telemetry has no frame 4000")).to_be_visible()
        assert window.complaints == []
