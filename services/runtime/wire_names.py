"""Whether names, hosts, ports and services elsewhere of `[wire]` go together."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from vemlight.errors import UserError
from vemlight.runtime.channels import INSTANCE, SERVICES, Instance, service_of
from vemlight.toml import choice_hint

if TYPE_CHECKING:
    from vemlight.settings import Settings, Wire

HOST = r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,252}[A-Za-z0-9_])?"  # a name or an IPv4 address
LOOPBACK = "127.0.0.1"
# Keys and `insecure` are for both: a relay of services on one machine publishes over tcp.
OF_TRANSPORT = {"ipc": ("folder",), "tcp": ("hosts", "port", "ports")}
OPTIONAL = {"plate": "[plate] source", "fixtures": "[fixtures] rig", "fuse": "[rig] file"}


def host_of(wire: "Wire", name: Instance) -> str:
    """Over tcp: where an instance runs."""
    return wire.hosts.get(name) or wire.hosts.get(service_of(name), LOOPBACK)


def first_port(wire: "Wire", name: Instance) -> int | None:
    """Over tcp: the first of an instance's two ports; None where one that is not called as its service has none."""
    found = wire.ports.get(name)
    if found is None and name in SERVICES:
        return wire.port + 2 * SERVICES.index(service_of(name))
    return found


def check_names(settings: "Settings", where: Path | str) -> None:
    """Raises UserError for names, ports and services elsewhere that do not go together."""
    wire = settings.wire
    for key in ("hosts", "ports"):
        for name in getattr(wire, key):
            if not re.fullmatch(INSTANCE, name):
                raise UserError(f"{where}: [wire.{key}] {name}: is no service; {choice_hint(name, SERVICES)}")
    for name, host in wire.hosts.items():
        if not re.fullmatch(HOST, host):
            raise UserError(f'{where}: [wire.hosts] {name} = "{host}": is no host; write a name or an IPv4 address alone, without a port')
    for service, name in wire.names.items():
        if service_of(name) != service:
            raise UserError(f'{where}: [wire.names] {service} = "{name}": is no name of a {service}; choose one such as "{service}.b"')
    if wrong := [name for name in wire.renderers if service_of(name) != "renderer"]:
        raise UserError(f'{where}: [wire] renderers: "{wrong[0]}" is no renderer; name some as "renderer" or "renderer.b"')
    if twice := [name for name in wire.renderers if wire.renderers.count(name) > 1]:
        raise UserError(f'{where}: [wire] renderers: "{twice[0]}" is there twice; each has a name of its own')
    if wire.renderers and settings.mode == "lossless":
        raise UserError(f'{where}: [wire] renderers: is for mode = "live"; in lossless mode none hurries the sampler')
    _check_transport(settings, where)
    _check_elsewhere(settings, where)
    _check_ports(settings, where)


def _check_transport(settings: "Settings", where: Path | str) -> None:
    """Raises UserError for keys of the transport that is not chosen."""
    wire, unset = settings.wire, type(settings.wire)()
    other = "ipc" if wire.transport == "tcp" else "tcp"
    for key in OF_TRANSPORT[other]:
        if getattr(wire, key) != getattr(unset, key):
            raise UserError(f'{where}: [wire] {key}: is for transport = "{other}"; leave it out, or set that')


def _check_elsewhere(settings: "Settings", where: Path | str) -> None:
    elsewhere = settings.wire.elsewhere
    if elsewhere and settings.mode == "lossless":
        raise UserError(f'{where}: [wire] elsewhere: is for mode = "live"; in lossless mode one run makes all frames')
    if settings.out and (writers := [service for service in elsewhere if service in ("sampler", "renderer")]):
        raise UserError(f"{where}: [wire] elsewhere: {writers[0]} writes there what `out` is for; leave one of them out")
    if missing := [service for service in elsewhere if service not in settings.services]:
        found = f"{missing[0]} is no part of these settings, which have no {OPTIONAL[missing[0]]}"
        raise UserError(f"{where}: [wire] elsewhere: {found}; set that as the other run does, or leave {missing[0]} out")


def _check_ports(settings: "Settings", where: Path | str) -> None:
    """Of all that are known by name two may have one port only on different hosts."""
    wire, viewer = settings.wire, settings.viewer
    taken: dict[tuple[str, int], Instance] = {}
    for name in _known(settings):
        first, host = first_port(wire, name), host_of(wire, name)
        for port in (first, first + 1) if first else ():
            if other := taken.get((host, port)):
                raise UserError(f"{where}: [wire] ports: {port} of {name} is taken by {other}, which has two; choose another")
            taken[host, port] = name
    page = host_of(wire, wire.names.get("viewer", "viewer")), viewer.port
    if wire.transport == "tcp" and (other := taken.get(page)):
        raise UserError(f"{where}: [viewer] port: {viewer.port} is taken by {other} on the wire; choose another")


def _known(settings: "Settings") -> Iterator[Instance]:
    """Those of the run, over tcp, and all that have ports. The cameras of a rig are among the latter, or have none."""
    wire = settings.wire
    own = [wire.names.get(service, service) for service in settings.services if not (service == "capture" and settings.rig.file)]
    yield from dict.fromkeys([*(own if wire.transport == "tcp" else ()), *wire.ports])
