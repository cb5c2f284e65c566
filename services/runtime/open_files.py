"""How many files a process may have open, and how many connections that leaves room for.

Each connection is a file. When there is none left, libzmq's ipc listener aborts the process (src/ipc_listener.cpp), so a service
disconnects peers long before.
"""

import resource

# Of a service without peers: sockets, monitors, libraries, the source. The viewer has 45, the sampler 40, and each of MAX_CAMERAS of a rig
# takes 4 more in fuse and viewer. 112 to 192 would do
OWN_FILES = 128
FEW_FILES = 1024  # below this the peers of a busy day are too many; 512 to 4096 would do
MAX_PEERS = 2048  # of a service: twice the thousand subscribers that one machine can serve with lights at 30 a second


def raise_file_limit() -> int:
    """Raises this process's limit of open files to its hard limit, and returns it."""
    hard = hard_file_limit()
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    return hard


def hard_file_limit() -> int:
    """To how many open files this process may raise its limit."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[1]


def file_limit() -> int:
    """How many files this process may have open now."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def peer_limit(files: int | None = None) -> int:
    """How many peers a service keeps that may have so many files open, as many as this process by default.

    A third of them, for libzmq goes on to accept until the surplus is disconnected.
    """
    return max(1, min(MAX_PEERS, ((file_limit() if files is None else files) - OWN_FILES) // 3))
