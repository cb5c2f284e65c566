"""Which share of the chunks is this process's, where an engine numbers its copies: Kubernetes' Indexed Job, and compose in its likeness."""

from collections.abc import Mapping

import msgspec

from vemlight.commands.options import ArchiveOptions
from vemlight.errors import UserError

INDEX = "JOB_COMPLETION_INDEX"  # kubernetes.io/docs/concepts/workloads/controllers/job, Completion mode


def with_index_of_job(options: ArchiveOptions, environ: Mapping[str, str]) -> ArchiveOptions:
    """The options, for --maps-only with the index of the environment where --index is left out. Raises UserError for one that is none."""
    text = environ.get(INDEX)
    if not options.maps_only or options.index is not None or text is None:
        return options
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise UserError(f"{INDEX}={text[:40]}: is no index of a job; count from 0, or say --index")
    if options.indices is None:
        raise UserError(f"--indices: is missing beside {INDEX}={text}; say the job's number of completions")
    return msgspec.structs.replace(options, index=int(text))
