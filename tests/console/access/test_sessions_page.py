"""The page of a person's log-ins, and what the log-in page says of one that has ended."""

import re


def test_a_person_sees_their_log_ins_and_ends_one_and_all_others(site, read):
    here, there, third = (site.visitor("ada") for _ in range(3))
    page = here.get("/sessions")
    assert page.count("this one") == 1
    ends = re.findall(r"/sessions/(\d+)/end", page)
    assert len(ends) == 2
    assert here.post(f"/sessions/{max(ends, key=int)}/end").headers["location"] == "/sessions"
    assert "The log-in is ended." in read(here.get("/sessions"))
    assert third.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    assert there.send("GET", "/audit").status_code == 200
    assert here.post("/sessions/end-others").status_code == 303
    assert "1 other log-in is ended." in read(here.get("/sessions"))
    assert there.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303
    assert "ended by the person" in read(here.get("/sessions"))


def test_an_administrator_sees_and_ends_anothers_and_nobody_else_does(site, read):
    victor, adele = site.visitor("victor"), site.visitor("adele")
    assert site.visitor("ada").send("GET", "/sessions?user=5").status_code == 403
    page = adele.get("/sessions?user=5")
    assert "Log-ins of Victor Viewer" in read(page)
    number = re.search(r"/sessions/(\d+)/end", page)[1]
    assert site.visitor("ada").post(f"/sessions/{number}/end").status_code == 404
    assert adele.post(f"/sessions/{number}/end").headers["location"] == "/sessions?user=5"
    assert victor.send("GET", "/audit", headers={"accept": "text/html"}).status_code == 303


def test_the_log_in_page_says_why_the_log_in_of_before_has_ended(site, read):
    victor = site.visitor("victor")
    site.visitor("adele").post("/users/5/roles", roles=["viewer", "analyst"])
    sent = victor.send("GET", "/runs?state=RUNNING", headers={"accept": "text/html"})
    assert sent.headers["location"] == "/login?next=%2Fruns%3Fstate%3DRUNNING&ended=roles_changed"
    assert "Your roles were changed, which ends every log-in" in read(victor.get(sent.headers["location"]))
    assert "<script>" not in victor.get("/login?ended=%3Cscript%3E")


def test_logging_out_ends_a_copied_cookie(site):
    visitor = site.visitor("ada")
    copied = dict(visitor.cookies)
    assert visitor.send("POST", "/logout", data={"csrf_token": visitor.csrf_token}).headers["location"] == "/login"
    visitor.cookies.update(copied)
    sent = visitor.send("GET", "/audit", headers={"accept": "text/html"})
    assert sent.headers["location"].endswith("&ended=logged_out")
    assert visitor.send("POST", "/logout", data={"csrf_token": visitor.csrf_token}).headers["location"] == "/login"
