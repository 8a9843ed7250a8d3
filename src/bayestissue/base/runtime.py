"""How an entry point sets up the numerical libraries; importing the library itself changes nothing."""

from __future__ import annotations

import gc
import hashlib
import os
import platform
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import wraps
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from bayestissue.base.results.files import file_sha256
from bayestissue.base.stopping import INTERRUPTED

# Of run folders: raised where this version no longer reads what the one before it wrote.
FORMAT = 1
LIBRARIES = ("bayestissue", "numpy", "scipy", "jax", "numpyro", "arviz", "pandas", "xarray")
_FOLDER = "JAX_COMPILATION_CACHE_DIR"
# The greatest seed that random numbers of every library can begin from.
MOST_SEED = 2**63 - 1
# Such an entry is compiled anew, which is no one's concern.
_UNKEPT = "Error (writing|reading) persistent compilation cache entry"
# JAX's settings of what is kept: all that is compiled. Under a limit of its own JAX looks through the whole
# folder whenever it keeps one more: 0.4 s beside the 12,000 that a GB holds, and a fit compiles some fifty.
_CACHE = {"jax_persistent_cache_min_compile_time_secs": 0.0, "jax_compilation_cache_max_size": -1}
# Bytes in the folder with which a process may begin; of more, it keeps those of late use, so many.
# What JAX calls an entry, wherever the folder is that somebody named.
_ENTRY = re.compile(r".+-[0-9a-f]{64}-cache")
_MOST_KEPT, _KEPT = 1_000_000_000, 800_000_000
# loky takes for a leak, and restarts with a warning, a process that has grown by 0.3 GB since its first task.
# A pool's first task is next to nothing: whatever is imported and compiled for the work itself comes later.
# All processes end with the work that they were begun for.
_NO_RECYCLING = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}


# What this process may use.
CORES = tuple(sorted(os.sched_getaffinity(0))) if hasattr(os, "sched_getaffinity") else ()


def configure() -> None:
    """Use float64 in the whole process; for a process of the program's own.

    Must be called before JAX computes anything.
    """
    import jax

    jax.config.update("jax_enable_x64", True)


def in_float64[**Arguments, Result](function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """``function``, computed in float64 whatever JAX is set to; the setting is as it was afterwards.

    Other threads keep theirs meanwhile. Where JAX is set to float32, arrays are returned as NumPy's: the next
    operation would round JAX's own to float32. Within `jax.jit`, `jax.grad` or `jax.vmap` a function is only
    put down, and worked off later, with the caller's setting: there the call is refused if that is float32,
    in which K and C have hardly a digit left.

    Raises:
        TypeError: called within such a transformation while JAX is set to float32.
    """

    @wraps(function)
    def computed(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        import jax

        if jax.config.jax_enable_x64:
            return function(*args, **kwargs)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            raise TypeError(
                f"{function.__name__} was called within jax.jit, jax.grad, jax.vmap or the like while JAX is "
                "set to float32; expected float64. Put the call of the transformed function into a block "
                '"with jax.enable_x64(True):", or begin with jax.config.update("jax_enable_x64", True).'
            )
        with jax.enable_x64(True):
            return jax.tree.map(_outside, function(*args, **kwargs))

    return computed


def of_arrays[**Arguments, Result](function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """A compiled ``function`` that takes what NumPy takes for an array too, such as a column of a table."""

    def array(value: Any) -> Any:
        import jax
        import numpy as np

        return value if value is None or isinstance(value, str | jax.Array) else np.asarray(value)

    @wraps(function)
    def of_any(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        return function(*map(array, args), **{name: array(value) for name, value in kwargs.items()})

    return of_any


def _outside(leaf: object) -> object:
    import jax
    import numpy as np

    return np.asarray(leaf) if isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer) else leaf


def keep_compiled() -> None:
    """Keep what is compiled in the user's cache folder, for later runs and for this run's worker processes.

    Must be called before JAX is imported. A folder named in ``JAX_COMPILATION_CACHE_DIR`` is used instead;
    where none can be made, everything is compiled anew each time.
    """
    folder = _cache_folder()
    if folder is None:
        os.environ.pop(_FOLDER, None)
        return
    os.environ[_FOLDER] = str(folder)
    for name, value in _CACHE.items():
        os.environ.setdefault(name.upper(), str(value))
    warnings.filterwarnings("ignore", _UNKEPT)


def quieten_libraries() -> None:
    """Keep libraries' warnings off the console, those of worker processes too.

    Such as that something compiles slowly, or a division. Must be called before JAX is imported.
    ``PYTHONWARNINGS`` and ``TF_CPP_MIN_LOG_LEVEL`` have them shown.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if not sys.warnoptions:
        os.environ["PYTHONWARNINGS"] = "ignore"
        warnings.simplefilter("ignore")


@contextmanager
def compiled_kept() -> Iterator[None]:
    """`keep_compiled` for the length of a block, where JAX was imported and has no such folder yet."""
    import jax
    from jax.experimental.compilation_cache import compilation_cache

    folder = None if jax.config.jax_compilation_cache_dir else _cache_folder()
    if folder is None:
        yield
        return
    settings = {"jax_compilation_cache_dir": str(folder), **_CACHE}
    before = {name: getattr(jax.config, name) for name in settings}
    try:
        for name, value in settings.items():
            jax.config.update(name, value)
        # JAX looks at these settings once, when it first compiles.
        compilation_cache.reset_cache()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", _UNKEPT)
            yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def _cache_folder() -> Path | None:
    """Where compiled functions are kept: made if it is not there; None if nowhere, or it can't be written.

    What was not used for long is removed from it, unless the environment tells JAX how much to keep.
    """
    from platformdirs import user_cache_path

    # What is compiled belongs to one kind of processor and one version of the compiler.
    kind = hashlib.sha256(f"{_processor()} {version('jaxlib')}".encode()).hexdigest()[:12]
    folder = Path(os.environ.get(_FOLDER) or user_cache_path("bayestissue") / f"compiled-{kind}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    if "JAX_COMPILATION_CACHE_MAX_SIZE" not in os.environ:
        _remove_unused(folder)
    return folder


def _remove_unused(folder: Path, most: int = _MOST_KEPT, target: int = _KEPT) -> None:
    """Of more than ``most`` bytes of compiled functions keep ``target``, those that were read latest.

    Another process may read or remove them meanwhile: what it misses it compiles anew.
    """
    entries = []
    # Without a `Path` of each: there are thousands, and every process begins here.
    with os.scandir(folder) as files:
        for entry in files:
            with suppress(OSError):
                if _ENTRY.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    status = entry.stat()
                    used = max(status.st_atime_ns, status.st_mtime_ns)
                    entries.append((used, status.st_size, entry.path))
    left = sum(size for _, size, _ in entries)
    for _, size, name in sorted(entries) if left > most else ():
        if left <= target:
            return
        with suppress(OSError):
            Path(name).unlink()
        left -= size


def release_compiled(most: int | None = None) -> None:
    """Forget all compiled code where it holds more than ``most`` memory mappings, by default half the limit.

    A compiled program holds some ten mappings and a fit some thousands. Past what Linux allows a process
    (``vm.max_map_count``, 65,530 unless set) the compiler ends it by a segmentation fault: after a dozen fits
    of different designs in one notebook. What is needed again is read from the folder of `keep_compiled`, or
    compiled anew.
    """
    import jax

    try:
        limit = int(Path("/proc/sys/vm/max_map_count").read_text(encoding="ascii"))
        mappings = Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        # Another system, which has no such limit.
        return
    if mappings > (limit // 2 if most is None else most):
        jax.clear_caches()
        gc.collect()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return " ".join(sorted({line for line in lines if line.startswith(("model name", "flags"))}))


def settle(parent: int, folder: str, allowed: tuple[int, ...]) -> None:
    """Set up a worker process: bind it to a core that no other worker in ``folder`` has taken, then as above.

    Args:
        parent: the process that began it, with which it ends.
        folder: an existing one; a file in it marks one of the ``allowed`` cores as taken.
        allowed: cores.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    for core in allowed:
        try:
            os.close(os.open(f"{folder}/core-{core}", os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            continue
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {core})
        break
    configure()


@contextmanager
def worker_pool(workers: int) -> Iterator[Any]:
    """A loky executor of processes set up by `settle`.

    They end with the block, and with this process, and leave a Ctrl-C, which a terminal sends to all
    processes, to it.
    """
    from loky import ProcessPoolExecutor

    with TemporaryDirectory(prefix="bayestissue-") as folder:
        to_settle = (os.getpid(), folder, CORES)
        pool = ProcessPoolExecutor(workers, initializer=settle, initargs=to_settle, env=_NO_RECYCLING)
        try:
            pool.submit(os.getpid)
            yield pool
        finally:
            pool.shutdown(wait=True, kill_workers=True)


def _end_with(parent: int) -> None:
    """End this process where the one that began it has ended."""
    while os.getppid() == parent:
        time.sleep(1)
    os._exit(INTERRUPTED)


def in_threads[Item, Result](
    function: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None
) -> Iterator[Result]:
    """``function`` of each item, in their order, all in float64, in so many threads or one a core.

    JAX's setting is each thread's own, and what is compiled leaves Python's lock to others.
    """
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads or cores()) as pool:
        yield from pool.map(in_float64(function), items)


def cores() -> int:
    """The number of processor cores that work is shared out over: those this process may use."""
    return len(CORES) or os.cpu_count() or 1


def versions() -> dict[str, str]:
    """The versions that a result depends on, for `run.json`."""
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}


@dataclass(frozen=True)
class CommandStart:
    """The moment at which a command began."""

    time: datetime = field(default_factory=lambda: datetime.now(UTC))
    clock: float = field(default_factory=perf_counter)

    @property
    def seconds(self) -> float:
        """How long ago that is."""
        return perf_counter() - self.clock

    def record(self, command: str, kind: str, **content: Any) -> dict[str, Any]:
        """The content of ``run.json`` at the end of the command."""
        return run_record(command, kind, self.time, self.seconds, **content)


def run_record(command: str, kind: str, started: datetime, seconds: float, **content: Any) -> dict[str, Any]:
    """The content of ``run.json``: which command, by which versions, of what, when and how long."""
    return {
        "program": "bayestissue",
        "format": FORMAT,
        "command": command,
        "kind": kind,
        "versions": versions(),
        **content,
        "started": started.isoformat(timespec="seconds"),
        "wall_time_s": round(seconds, 1),
    }


def content_hash(paths: Iterable[Path]) -> str:
    """SHA-256 over the names and contents of ``paths``, whatever folder they lie in."""
    digest = hashlib.sha256()
    for path in sorted(paths, key=lambda path: path.name):
        digest.update(path.name.encode() + b"\0" + bytes.fromhex(file_sha256(path)))
    return digest.hexdigest()
