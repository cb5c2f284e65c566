"""Which names a browser may use for this machine, and who needs a token."""

import re
from urllib.parse import urlsplit

import msgspec
import pytest

from vemlight.runtime.token import is_loopback, with_token
from vemlight.settings import Settings, Viewer
from vemlight.viewer.authentication import is_origin, is_token, known_host
from vemlight.viewer.service import address

NAMES = {"localhost", "stage.example"}


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:80", "127.0.0.1:8080", "[::1]:8080", "192.168.1.7", "stage.example:8080"])
def test_numbers_and_known_names_pass(host):
    assert known_host(host, NAMES)


@pytest.mark.parametrize(
    "host",
    ["", "attacker.example", "localhost.attacker.example", "127.0.0.1.attacker.example", "[::1", "localhost:http", ":8080", "a@localhost.x",
     "127.0.0.1:99999999", "stage.example.", "0x7f.1"],
)  # fmt: skip
def test_others_do_not(host):
    assert not known_host(host, NAMES)


@pytest.mark.parametrize(
    ("origin", "scheme", "host"),
    [("http://127.0.0.1:8080", "http", "127.0.0.1:8080"), ("https://stage.example", "https", "stage.example:443"),
     ("http://LOCALHOST", "http", "localhost:80"), ("http://[::1]:8080", "http", "[::1]:8080")],
)  # fmt: skip
def test_the_page_itself_is_its_scheme_name_and_port(origin, scheme, host):
    assert is_origin(origin, scheme, host)


@pytest.mark.parametrize(
    "origin",
    ["http://127.0.0.1", "http://127.0.0.1:8081", "https://127.0.0.1:8080", "http://localhost:8080", "null", "", "127.0.0.1:8080", "http://",
     "http://127.0.0.1:http", "file://127.0.0.1:8080", "ws://127.0.0.1:8080"],
)  # fmt: skip
def test_another_scheme_name_or_port_is_another_page(origin):
    assert not is_origin(origin, "http", "127.0.0.1:8080")


def test_who_reaches_an_address():
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.8.8.8", "::1", "localhost"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "10.1.2.3", "stage.example"))


def token_of(**viewer) -> str:
    return with_token(Settings(viewer=msgspec.convert(viewer, Viewer))).viewer.token


def test_who_reaches_it_from_elsewhere_needs_a_token():
    assert token_of() == token_of(host="::1") == token_of(host="0.0.0.0", insecure=True) == ""
    assert token_of(token="1234567890abcdef") == token_of(host="0.0.0.0", token="1234567890abcdef") == "1234567890abcdef"
    tokens = {token_of(host=host) for host in ("0.0.0.0", "::", "10.1.2.3", "stage.example") for _ in range(3)}
    assert len(tokens) == 12
    for token in tokens:
        assert msgspec.convert({"token": token}, Viewer).token == token  # of the kind that the settings take
        assert len(token) == 32


@pytest.mark.parametrize("token", ["short", "1234567890abcde", "1234567890 abcdef", "1234567890abcde&", "x" * 129])
def test_a_token_that_is_short_or_no_part_of_an_address_is_refused(token):
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"token": token}, Viewer)


def test_a_token_without_effect_is_refused():
    with pytest.raises(msgspec.ValidationError, match="exclude each other"):
        msgspec.convert({"token": "1234567890abcdef", "insecure": True}, Viewer)


def test_only_the_token_is_the_token():
    assert is_token("abcdefghijklmnop", "abcdefghijklmnop")
    for other in ("", "abcdefghijklmno", "abcdefghijklmnopq", "ABCDEFGHIJKLMNOP", "abcdefghijklmno\udc80", "abcdefghijklmn\u00e9p"):
        assert not is_token(other, "abcdefghijklmnop")


@pytest.mark.parametrize(
    ("viewer", "line"),
    [
        ({}, "http://127.0.0.1:8080 (for this machine only)"),
        ({"host": "::1", "port": 90}, "http://[::1]:90 (for this machine only)"),
        ({"token": "1234567890abcdef"}, "http://127.0.0.1:8080/?token=1234567890abcdef (for this machine only)"),
        ({"host": "stage.example", "insecure": True}, "http://stage.example:8080 (for EVERYONE who reaches this machine over the network)"),
    ],
)
def test_the_address_that_is_printed(viewer, line):
    assert address(msgspec.convert(viewer, Viewer)) == f"the viewer is at {line}"


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_an_address_for_others_is_one_that_they_can_open(host):
    line = address(with_token(Settings(viewer=Viewer(host=host))).viewer)
    url = urlsplit(re.findall(r"http://\S+", line)[0])
    assert known_host(url.netloc, set())  # a number
    assert url.hostname != host
    assert "(for everyone on the network who has this address)" in line
