"""How soon the newest frame is there again when a link between two hosts heals, and how old frames are over a bad one.

    python -m bench.healing [--cuts 5 60] [--times 2] [--kinds lights map] [--keys 0 1]

Two network namespaces with a link whose packets are carried by this process: none arrives while it is cut. A stand-in for the service
publishes 30 frames a second by the service's own socket on one side, and a subscriber by the services' own socket takes them on the other.
Healed: from the end of the cut until a frame that was made since is in the subscriber's hand. Needs root, iproute2 and /dev/net/tun.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np

from bench.fan_out import FPS
from tests.support.linked_listener import LinkedListener
from tests.support.packet_link import HERE, PacketLink, possible
from vemlight.runtime.transport import make_keys
from vemlight.settings import Wire

SERVICES = {"lights": "sampler", "map": "capture"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cuts", type=float, nargs="*", default=[5, 60])
    parser.add_argument("--times", type=int, default=2)
    parser.add_argument("--kinds", nargs="*", default=["lights", "map"])
    parser.add_argument("--keys", type=int, nargs="*", default=[0, 1])
    parser.add_argument("--seconds", type=float, default=20)
    given = parser.parse_args()
    if not possible():
        sys.exit("needs root, iproute2 and /dev/net/tun")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder:
        make_keys(Path(folder) / "keys")
        for kind in given.kinds:
            for keyed in given.keys:
                keys = f"{folder}/keys" if keyed else ""
                settings = Wire(transport="tcp", hosts={SERVICES[kind]: HERE}, keys=keys, insecure=not keyed)
                measure(settings, kind, "with keys" if keyed else "plain", given)


def measure(settings: Wire, kind: str, keys: str, given: argparse.Namespace) -> None:
    publisher = ("bench.fan_out", "--publish", kind, msgspec.json.encode(settings).decode(), "0")
    with PacketLink() as link, LinkedListener(link, publisher, settings, SERVICES[kind], kind) as listener:
        for cut_s in given.cuts:
            healed = []
            for _ in range(given.times):
                healed.append(listener.healed_s(cut_s))
                time.sleep(3)
            print(f"{kind}, {keys}: a cut of {cut_s:g} s: {', '.join(f'{one:.2f}' for one in healed)} s", flush=True)
    for what, delay_s, loss in (("loss of 1 %, 10 ms each way", 0.01, 0.01), ("200 ms each way", 0.2, 0.0)):
        with PacketLink(delay_s, loss) as link, LinkedListener(link, publisher, settings, SERVICES[kind], kind) as listener:
            ages_ms = listener.ages_ms(given.seconds)
            p50, p99 = np.percentile(ages_ms, [50, 99]) if ages_ms else (np.nan, np.nan)
            share = len(ages_ms) / (given.seconds * FPS)
            print(f"{kind}, {keys}: {what}: {100 * share:.0f} % of frames, age p50 {p50:.0f} ms, p99 {p99:.0f} ms", flush=True)


if __name__ == "__main__":
    main()
