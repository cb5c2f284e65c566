"""Whether a service lives: it publishes its status twice a second, and the health check waits for one."""

import sys
import time

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.channels import REPORT_PERIOD_S, SERVICES, STATUS, Instance, service_of
from vemlight.runtime.instances import instances
from vemlight.runtime.peers import receive
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

STATUS_TIMEOUT_S = (1 + STATUS.max_missed) * REPORT_PERIOD_S  # connecting and the keys' handshake take under 0.1 s


def next_status(settings: Settings, service: Instance, timeout_s: float) -> wire.StatusMessage | None:
    """The next status that `service` publishes, or None when none comes in time. Raises UserError for keys that cannot be used."""
    transport = Transport(settings.wire)
    try:
        socket = transport.subscribe(service, STATUS.kind)
        until_s = time.monotonic() + timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            if not socket.poll(left_s * 1e3):
                return None
            try:
                header, _ = wire.unpack(receive(socket).parts)
            except wire.VersionError as error:
                sys.exit(f"vemlight: {service}: {error}")
            except ValueError:
                continue
            if isinstance(header, wire.StatusMessage) and header.service == service:
                return header
        return None
    finally:
        transport.close()


def check_health(settings: Settings, service: Instance) -> None:
    """Prints how `service` is doing; exits with status 1 and one line on stderr when no status comes within STATUS_TIMEOUT_S.

    Raises UserError for keys that cannot be used, and for a name that no process of the settings has.
    """
    known = instances(settings)
    if service not in known and (service in SERVICES or (settings.rig.file and service_of(service) == "capture")):
        raise UserError(f"{service}: no process of these settings is called so; ask for one of {', '.join(known)}")
    status = next_status(settings, service, STATUS_TIMEOUT_S)
    if status is None:
        sys.exit(f"vemlight: {service}: no status within {STATUS_TIMEOUT_S:g} s; start it, or see its own output")
    frame = "no frame yet" if status.sequence is None else f"frame {status.sequence}, {status.rate_hz:.1f} a second"
    print(f"vemlight: {service}: {frame}")
