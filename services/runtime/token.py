"""The token that the viewer requires when it can be reached from other machines."""

import ipaddress
import secrets

import msgspec

from vemlight.settings import Settings

TOKEN_BYTES = 24  # 192 random bits: at a million guesses a second 10^44 years; 16 bytes and more would do


def is_loopback(host: str) -> bool:
    """Whether what listens at `host`, a name or a number, can be reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def with_token(settings: Settings) -> Settings:
    """The settings, with a new token where the viewer needs one and none is set."""
    viewer = settings.viewer
    if viewer.token or viewer.insecure or is_loopback(viewer.host):
        return settings
    return msgspec.structs.replace(settings, viewer=msgspec.structs.replace(viewer, token=secrets.token_urlsafe(TOKEN_BYTES)))
