"""Webhook targets: every address of a name is judged, whatever form it is written in."""

import ipaddress
import socket
from typing import Any

import pytest

from boresight.errors import RefusedInputError
from boresight.platform.web.targets import WebhookTargets, addresses_of_this_machine, read_hosts, refuse_address
from tests.refusals import has_code

PUBLIC = ("93.184.215.14", "2606:2800:21f:cb07:6820:80da:af6b:8b2c", "::ffff:93.184.215.14", "172.15.0.1", "172.32.0.1")
LOCAL = ("127.0.0.1", "127.255.255.254", "::1", "169.254.1.1", "fe80::1", "::ffff:127.0.0.1", "::ffff:7f00:1")
PRIVATE = (
    "10.0.0.1", "172.16.0.1", "172.31.255.254", "192.168.1.1", "fc00::1", "fd12:3456::1", "::ffff:10.0.0.1",
)  # fmt: skip
NEVER = (
    "169.254.169.254", "::ffff:169.254.169.254", "fd00:ec2::254", "100.100.100.200", "168.63.129.16",
    "0.0.0.0", "::", "100.64.0.1", "100.127.255.254", "198.18.0.1", "198.19.255.254", "192.0.0.1", "192.0.2.1",  # noqa: S104 - judged, not listened on
    "198.51.100.7", "203.0.113.9", "192.88.99.1", "224.0.0.1", "239.255.255.255", "240.0.0.1", "255.255.255.255",
    "ff02::1", "ff0e::1", "fec0::1", "100::1", "2001:db8::1", "2001:2::1", "2001:10::1", "2001:20::1", "3fff::1", "5f00::1",
    "64:ff9b::7f00:1", "64:ff9b::127.0.0.1", "64:ff9b::5db8:d70e", "64:ff9b:1::a9fe:a9fe", "64:ff9b:1:ffff::1",
    "2002:7f00:1::", "2002:5db8:d70e::1", "2001:0:4136:e378:8000:63bf:3fff:fdd2", "::127.0.0.1", "::93.184.215.14",
    "::ffff:0:127.0.0.1", "2606:2800::5efe:10.0.0.1", "2606:2800::200:5efe:127.0.0.1",
)  # fmt: skip


def _none() -> frozenset[Any]:
    return frozenset()


def _refused(addresses: tuple[str, ...], targets: WebhookTargets) -> list[str]:
    return [address for address in addresses if targets.why_not(address) is not None]


def test_by_default_only_addresses_of_the_internet_are_reached() -> None:
    refused = (*LOCAL, *PRIVATE, *NEVER)
    assert _refused(PUBLIC, WebhookTargets(own=_none)) == []
    assert _refused(refused, WebhookTargets(own=_none)) == list(refused)


def test_each_setting_allows_its_own_networks_and_nothing_else() -> None:
    assert _refused((*LOCAL, *PRIVATE, *NEVER), WebhookTargets(local=True, own=_none)) == [*PRIVATE, *NEVER]
    assert _refused((*LOCAL, *PRIVATE, *NEVER), WebhookTargets(private=True, own=_none)) == [*LOCAL, *NEVER]
    assert _refused(NEVER, WebhookTargets(local=True, private=True, own=_none)) == list(NEVER)


def test_every_address_of_this_machine_is_refused_and_the_one_it_listens_on() -> None:
    own = frozenset({ipaddress.ip_address("93.184.215.14")})
    targets = WebhookTargets(private=True, listening="2606:2800::5", own=lambda: own)
    asked = ("93.184.215.14", "::ffff:93.184.215.14", "2606:2800::5", "93.184.215.15")
    assert _refused(asked, targets) == list(asked[:3])
    assert WebhookTargets(local=True, own=lambda: own).why_not("93.184.215.14") is None


def test_the_addresses_of_the_interfaces_are_known() -> None:
    found = {str(address) for address in addresses_of_this_machine()}
    assert "127.0.0.1" in found
    assert all(WebhookTargets(private=True).why_not(text) for text in found)


def test_one_bad_address_of_a_name_refuses_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def look_up(_host: str, port: int, **_: Any) -> list[Any]:
        return [(2, 1, 6, "", (address, port)) for address in ("93.184.215.14", "10.9.8.7")]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with pytest.raises(RefusedInputError, match=r"10\.9\.8\.7.*BORESIGHT_WEBHOOKS_PRIVATE"):
        WebhookTargets(own=_none).addresses("mixed.example", 443)
    assert WebhookTargets(private=True, own=_none).addresses("mixed.example", 443) == ["93.184.215.14", "10.9.8.7"]


@pytest.mark.parametrize(
    "host", ["2130706433", "0x7f.1", "0177.0.0.1", "127.1", "localhost", "LOCALHOST", "[::ffff:7f00:1]", "[::1]"]
)
def test_other_spellings_of_this_machine_are_refused_too(host: str) -> None:
    with pytest.raises(RefusedInputError, match="not allowed"):
        refuse_address(f"http://{host}/hook", WebhookTargets())


def test_a_name_that_leads_nowhere_yet_may_be_given() -> None:
    refuse_address("https://mission.invalid/hook", WebhookTargets())


@pytest.mark.parametrize(
    ("host", "allowed"),
    [
        ("hooks.mission.example", True),
        ("HOOKS.Mission.Example.", True),
        ("a.chat.example", True),
        ("a.b.chat.example", True),
        ("chat.example", False),
        ("evilchat.example", False),
        ("mission.example", False),
        ("hooks.mission.example.evil.test", False),
        ("93.184.215.14", True),
        ("::ffff:93.184.215.15", False),
        ("xn--bcher-kva.example", True),
    ],
)
def test_with_a_list_only_its_hosts_are_allowed(host: str, allowed: bool) -> None:
    targets = WebhookTargets(hosts=read_hosts("hooks.mission.example, *.chat.example 93.184.215.14 bücher.example"))
    if allowed:
        targets.refuse_host(host)
    else:
        with pytest.raises(RefusedInputError, check=has_code("host-not-allowed")):
            targets.refuse_host(host)


@pytest.mark.parametrize("text", ["*", "*.", "a.*.example", "https://a.example/"])
def test_an_entry_that_is_no_host_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"\*|https"):
        read_hosts(text)
