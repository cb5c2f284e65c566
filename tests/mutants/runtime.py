"""Mutants of files, messages, sockets and processes."""

from tests.mutants.mutant import mutants_of

RUNTIME = "services/runtime/"

MUTANTS = [
    *mutants_of("services/files.py", "tests/test_files.py", [
        ("length of a TOML file doubled", "MAX_TOML_BYTES = 2**20", "MAX_TOML_BYTES = 2**21"),
        ("parts of a key doubled", "MAX_KEY_DOTS = 32", "MAX_KEY_DOTS = 64"),
        ("devices read as files", "if not stat.S_ISREG(status.st_mode):", "if False:"),
        ("a byte order mark", ".removeprefix(codecs.BOM_UTF8)", ""),
        ("half-written files", "        part.unlink(missing_ok=True)\n", "        pass\n"),
    ]),
    *mutants_of(RUNTIME + "transport.py", "tests/test_transport.py", [
        ("socket folder's permissions", "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077",
         "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o007"),
        ("key file's permissions", "secret.stat().st_mode) & 0o077", "secret.stat().st_mode) & 0o007"),
        ("mode of a new folder", "mode=0o700, parents=True, exist_ok=True)\n        found", "parents=True, exist_ok=True)\n        found"),
        ("length of a socket's path", "if longest > 107:", "if longest > 108:"),
        ("largest part accepted", "socket.maxmsgsize = wire.MAX_PART", "socket.maxmsgsize = -1"),
        ("queue of a socket", "socket.sndhwm = socket.rcvhwm = QUEUE_FRAMES", "socket.sndhwm = socket.rcvhwm = 1000"),
        ("handshake", "HANDSHAKE_MS = 2000", "HANDSHAKE_MS = 30000"),
        ("subscriptions to unknown topics", "if topic in TOPICS:", "if True:"),
        ("secret key's mode", "secret.chmod(0o600)", "secret.chmod(0o644)"),
        ("a second process at a socket", "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB"),
        ("ports of a service", "2 * SERVICES.index(service)", "1 * SERVICES.index(service)"),
    ]),
    *mutants_of(RUNTIME + "wire.py", "tests/test_wire.py", [
        ("nan in half-float arrays", 'if dtype in ("<f2", "<f4") and', 'if dtype in ("<f4",) and'),
        ("header doubled", "MAX_HEADER = 64 * 1024", "MAX_HEADER = 128 * 1024"),
        ("part doubled", "MAX_PART = 64 * 1024 * 1024", "MAX_PART = 128 * 1024 * 1024"),
        ("poses doubled", "MAX_POSES = 128", "MAX_POSES = 256"),
        ("unit vectors doubled", "UNIT = 1e-3", "UNIT = 4e-3"),
        ("unit vectors halved", "UNIT = 1e-3", "UNIT = 2.5e-4"),
        ("parts of a message", "MAX_PARTS = 7", "MAX_PARTS = 8"),
        ("negative irradiance", "or (irradiance < 0).any():", "or False:"),
        ("bright cells out of order", "(np.diff(arrays[1]) >= 0).all() and", ""),
        ("weight of a bright cell", "& (arrays[3] <= 1)", ""),
        ("bright cells beyond the map", "arrays[1] < header.rows * header.cols", "arrays[1] <= header.rows * header.cols"),
        ("topic of another kind", "if bytes(parts[0]) != _kind(header).encode():", "if False:"),
        ("versions", "if version != VERSION:", "if version > VERSION:"),
    ]),
    *mutants_of(RUNTIME + "demand.py", "tests/test_demand.py", [
        ("`extends`: a request that extends another", "extends = request.first == until and", "extends = request.first <= until and"),
        ("`extends`: after the last was sent", "and next_frame < until", "and next_frame <= until", "both then begin at the same frame"),
        ("consumers doubled", "MAX_CONSUMERS = 64", "MAX_CONSUMERS = 128"),
        ("window doubled", "WINDOW_FRAMES = 4", "WINDOW_FRAMES = 8"),
        ("asked again later", "ASK_AGAIN_S = 1.0", "ASK_AGAIN_S = 10.0"),
        ("the end of the stream", "following >= end:", "following > end:"),
    ]),
    *mutants_of(RUNTIME + "sync.py", "tests/test_sync.py", [
        ("last frames", "LAST_FRAMES = 16", "LAST_FRAMES = 1"),
        ("clocks of two machines", "same_clock = stamp.boot_id and stamp.boot_id == header.stamp.boot_id", "same_clock = True"),
    ]),
    *mutants_of(RUNTIME + "service_stats.py", "tests/test_service_stats.py", [
        ("rate over a longer time", "RATE_WINDOW_S = 2.0", "RATE_WINDOW_S = 20.0"),
        ("a producer that starts again", "or frames < self._first + self._came:", "or False:"),
        ("dropped frames", "self._before + frames - self._first - self._came", "self._before + frames - self._first"),
        ("intervals of a rate", "rate_hz = (len(recent) - 1) /", "rate_hz = len(recent) /"),
    ]),
    *mutants_of(RUNTIME + "token.py", "tests/test_viewer_authentication.py", [
        ("token halved", "TOKEN_BYTES = 24", "TOKEN_BYTES = 12"),
        ("loopback", "return ipaddress.ip_address(host).is_loopback", "return ipaddress.ip_address(host).is_private"),
    ]),
    *mutants_of(RUNTIME + "supervise.py", "tests/test_supervise.py", [
        ("back-off", "len(BACK_OFF_S)) - 1]", "len(BACK_OFF_S)) - 2]"),
        ("deaths before giving up", "GIVE_UP = 5", "GIVE_UP = 50"),
    ]),
]
