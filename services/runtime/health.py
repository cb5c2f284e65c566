"""Whether a service lives: it says its status twice a second, and a check hears one."""

import sys
import time

from vemlight.runtime import wire
from vemlight.runtime.channels import STATUS_PERIOD_S, Service
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

HEARD_S = 4 * STATUS_PERIOD_S  # connecting and the keys' handshake take under 0.1 s: at least three reports in a row are missing


def next_status(settings: Settings, service: Service, within_s: float) -> wire.StatusMessage | None:
    """The next status that `service` says, or None when none comes in time. Raises UserError for keys that cannot be used."""
    transport = Transport(settings.wire)
    try:
        socket = transport.subscribe(service, "status")
        until_s = time.monotonic() + within_s
        while (left_s := until_s - time.monotonic()) > 0:
            if not socket.poll(left_s * 1e3):
                return None
            try:
                header, _ = wire.unpack(socket.recv_multipart())
            except ValueError:
                continue
            if isinstance(header, wire.StatusMessage) and header.service == service:
                return header
        return None
    finally:
        transport.close()


def check_health(settings: Settings, service: Service) -> None:
    """Prints how `service` fares; ends the program with status 1 and one line on stderr when it says nothing for HEARD_S.

    Raises UserError for keys that cannot be used.
    """
    status = next_status(settings, service, HEARD_S)
    if status is None:
        sys.exit(f"vemlight: {service}: has said nothing for {HEARD_S:g} s; start it, or see its own output")
    frame = "no frame yet" if status.sequence is None else f"frame {status.sequence}, {status.rate_hz:.1f} a second"
    print(f"vemlight: {service}: {frame}")
