"""Which addresses a webhook's messages may go to.

A webhook must not give access to what only the server can reach. So a host is checked by every address that its name resolves to:
when a webhook is made, and again before each attempt, when the connection goes to an address that was checked.

=========================== ====================================================================================
refused always              metadata of clouds, multicast, reserved, benchmarking and documentation networks,
                            carriers' shared network (100.64.0.0/10), and every form of IPv6 that carries an IPv4
                            address through a translator or a tunnel (NAT64, 6to4, Teredo, IPv4-compatible, ISATAP)
unless `webhooks_local`     loopback, the link, and each address of this machine's interfaces
unless `webhooks_private`   private networks: RFC 1918 and unique local IPv6 addresses
=========================== ====================================================================================

An IPv4-mapped address is judged as the IPv4 address that it is. Where `webhook_hosts` names hosts, every other is refused.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from urllib.parse import urlsplit

from boresight.errors import RefusedInputError

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network

LOOK_UP_S = 5.0
LONGEST_URL = 2000


def _networks(*texts: str) -> tuple[Network, ...]:
    return tuple(ipaddress.ip_network(text) for text in texts)


METADATA = _networks(
    "169.254.169.254/32", "169.254.170.0/24", "100.100.100.200/32", "168.63.129.16/32", "192.0.0.192/32", "fd00:ec2::/32"
)  # fmt: skip
LOCAL = _networks("127.0.0.0/8", "169.254.0.0/16", "::1/128", "fe80::/10")
PRIVATE = _networks("10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "fc00::/7")
RESERVED = _networks(
    "0.0.0.0/8", "100.64.0.0/10", "192.0.0.0/24", "192.0.2.0/24", "192.88.99.0/24", "198.18.0.0/15", "198.51.100.0/24",
    "203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4",
    "2001::/23", "2001:db8::/32", "3fff::/20",
)  # fmt: skip
CARRYING_IPV4 = {
    "NAT64": _networks("64:ff9b::/96", "64:ff9b:1::/48"),
    "6to4": _networks("2002::/16"),
    "Teredo": _networks("2001::/32"),
    "IPv4-compatible": _networks("::/96"),
    "IPv4-translated": _networks("::ffff:0:0:0/96"),
}
ISATAP = (0x00005EFE, 0x02005EFE)  # the upper half of the interface's identifier
GLOBAL_UNICAST = ipaddress.IPv6Network("2000::/3")


def addresses_of_this_machine() -> frozenset[Address]:
    """Return the current addresses of this machine's interfaces."""
    import psutil  # noqa: PLC0415 - settings are read by every command, and few ask this

    families = {socket.AF_INET, socket.AF_INET6}
    return frozenset(
        ipaddress.ip_address(one.address.partition("%")[0])
        for interface in psutil.net_if_addrs().values()
        for one in interface
        if one.family in families
    )


@dataclass(frozen=True)
class WebhookTargets:
    """The addresses that an installation allows for webhooks."""

    local: bool = False
    private: bool = False
    hosts: tuple[str, ...] = ()
    listening: str = ""
    own: Callable[[], frozenset[Address]] = addresses_of_this_machine

    def refuse_host(self, host: str) -> None:
        """Refuse a host that is not on the list, where there is one."""
        if self.hosts and not any(_matches(plain_host(host), entry) for entry in self.hosts):
            raise RefusedInputError(
                f"{host} is not one of the hosts that webhooks may go to: choose one of "
                f"{', '.join(self.hosts)}, or add it to BORESIGHT_WEBHOOK_HOSTS.",
                code="host-not-allowed",
            )

    def addresses(self, host: str, port: int) -> list[str]:
        """Return every address that a name resolves to, if all of them are allowed."""
        self.refuse_host(host)
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        texts = list(dict.fromkeys(str(known[4][0]) for known in found))
        for text in texts:
            if (why := self.why_not(text)) is not None:
                raise RefusedInputError(f"{host} resolves to {text}, {why}.")
        return texts

    def why_not(self, text: str) -> str | None:
        """Return why an address is not allowed and which setting would allow it; None if it is allowed."""
        address = _unmapped(ipaddress.ip_address(text.partition("%")[0]))
        if (form := _carried(address)) is not None:
            return f"an IPv4 address in {form} form, which is not allowed: give the IPv4 address itself"
        if _within(address, METADATA):
            return "a cloud metadata address, which is not allowed: use another address"
        if _within(address, LOCAL) or address in self._own():
            hint = "set BORESIGHT_WEBHOOKS_LOCAL=1 if that is intended"
            return None if self.local else f"an address of this machine or its link, which is not allowed: {hint}"
        if _within(address, PRIVATE):
            hint = "set BORESIGHT_WEBHOOKS_PRIVATE=1 if receivers are in it"
            return None if self.private else f"an address of a private network, which is not allowed: {hint}"
        if _within(address, RESERVED) or (address.version == 6 and address not in GLOBAL_UNICAST):
            return "a reserved address, which is not allowed: use another address"
        return None

    def _own(self) -> frozenset[Address]:
        """Return this machine's addresses, with the one that the server listens on."""
        try:
            return self.own() | {_unmapped(ipaddress.ip_address(self.listening))}
        except ValueError:  # a host name, whose addresses are those of the interfaces
            return self.own()


def read_hosts(text: str) -> tuple[str, ...]:
    """Read a list of hosts, exact or `*.suffix`, separated by commas or spaces."""
    entries = [plain_host(entry) for entry in text.replace(",", " ").split()]
    for entry in entries:
        bare = entry.removeprefix("*.")
        if not bare or "*" in bare or "/" in bare:
            raise ValueError(entry)
    return tuple(dict.fromkeys(entries))


def plain_host(host: str) -> str:
    """Normalise a host: lower case, without brackets and final dot, in the DNS form of international names."""
    bare = host.strip().strip("[]").rstrip(".").lower()
    try:
        return str(ipaddress.ip_address(bare))
    except ValueError:
        pass
    try:
        return bare if bare.isascii() else bare.encode("idna").decode()
    except UnicodeError:
        return bare


def _matches(host: str, entry: str) -> bool:
    """Whether a host matches an entry of the list, a name or a suffix."""
    return host.endswith(entry[1:]) and host != entry[2:] if entry.startswith("*.") else host == entry


def _unmapped(address: Address) -> Address:
    """Return the IPv4 address of an IPv4-mapped one; any other unchanged."""
    return (address.version == 6 and address.ipv4_mapped) or address


def _carried(address: Address) -> str | None:
    """Name the form in which an IPv6 address carries an IPv4 address; None when it does not."""
    if address.version == 4 or int(address) <= 1:  # :: and ::1 are themselves
        return None
    if (int(address) >> 32) & 0xFFFFFFFF in ISATAP:
        return "ISATAP"
    return next((form for form, networks in CARRYING_IPV4.items() if _within(address, networks)), None)


def _within(address: Address, networks: Iterable[Network]) -> bool:
    return any(address.version == network.version and address in network for network in networks)


def parsed(url: str) -> tuple[str, int]:
    """Return host and port of an address that a webhook may have."""
    wrong = RefusedInputError(f"{url!r} is not an address; write it like https://mission.example/hooks.")
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        raise wrong from None
    if parts.scheme not in {"http", "https"} or not parts.hostname or port == 0:
        raise wrong
    if "@" in parts.netloc or parts.fragment:
        raise RefusedInputError("A webhook's address must not contain a user name, password or #part; give it without.")
    if len(url) > LONGEST_URL:
        raise RefusedInputError(f"The address has {len(url)} characters; shorten it to {LONGEST_URL}.")
    try:
        parts.hostname.encode("idna")
    except UnicodeError:  # an empty label, or one that is too long
        raise wrong from None
    return parts.hostname, port or (443 if parts.scheme == "https" else 80)


def refuse_address(url: str, targets: WebhookTargets) -> None:
    """Refuse an invalid address, or one that resolves to where messages may not go.

    A name that does not resolve now is accepted, because it is checked again before each message. This makes DNS queries, so
    call it outside writing transactions.
    """
    host, port = parsed(url)
    targets.refuse_host(host)
    threads = ThreadPoolExecutor(1, "boresight-look-up")
    try:
        threads.submit(targets.addresses, host, port).result(LOOK_UP_S)
    except OSError:  # TimeoutError is one
        return
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
