"""A plan of pointings by keyboard: the form is filled and sent, the plan stands beside it, the CSV comes down, the page holds."""

from playwright.sync_api import expect

LINES = "10 5 0\n120 -40 30\n200 60 90\n300 20 45"


def test_a_plan_is_asked_for_by_keyboard_read_and_taken_along(people):
    address = "/sensors/1"
    with people.seat("analyst") as window:
        page = window.page
        window.open(address)
        page.get_by_role("link", name="Plan", exact=True).press("Enter")
        page.wait_for_url(f"**{address}/plan")
        page.get_by_label("Minutes").focus()
        page.keyboard.press("ControlOrMeta+a")
        page.keyboard.type("5")
        page.get_by_text("Candidates and criterion").press("Enter")
        page.get_by_label("Attitudes that may be chosen").fill(LINES)
        page.get_by_label("Sun (°)").fill("0")
        page.get_by_label("Moon (°)").fill("0")
        page.get_by_label("Minutes").press("Enter")
        table = page.get_by_role("table", name="Pointings in order")
        expect(table).to_be_visible()
        assert 1 < table.get_by_role("row").count() <= 6
        expect(page.locator(".page-head .status").first).to_contain_text("gate")
        expect(page.get_by_label("Minutes")).to_have_value("5")
        expect(page.get_by_role("table", name="One σ of each parameter")).to_contain_text("f_m")
        window.holds_in_themes_and_widths("plan")
        window.holds_in_widths("plan")
        with page.expect_download() as coming:
            page.get_by_role("button", name="Download CSV").press("Enter")
        assert coming.value.path().read_text().splitlines()[0].count("ra_deg") == 1
        page.get_by_label("Minutes").fill("1440")
        page.get_by_role("button", name="Plan").press("Enter")
        expect(page.locator(".notice")).to_contain_text("dwells")
        assert window.barriers() == []
        window.forgive("status of 422")
