"""Files and folders that appear complete or not at all; text files, errors with the file's name, and ``config/``.

Each is written in a folder next to its path, synced to disk, and moved there; that folder is then removed.
What a process that was killed left there is removed by the next one that writes to the same path.
"""

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir, mkdtemp
from typing import Any

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.signals import postponed

UNFINISHED = ".unfinished"
"""End of the names of folders for what is being written: no other software has it, and no file of a user."""

_OLDER = ".older"
"""End of the name of what had the place before, until all that is written together is in place."""


@contextmanager
def write_set(paths: Iterable[Path]) -> Iterator[list[Path]]:
    """Give places to write files or folders to, and move all to their paths, or none, when that went well.

    Paths without content are left out. An existing file is replaced at once, and its mode is kept; an existing folder
    is never replaced. A symbolic link stays, and the path it leads to is written. After a failure everything is as it
    was.

    Parameters
    ----------
    paths : iterable of Path
        Where the files or folders shall be.

    Yields
    ------
    list of Path
        For each a path of the same name in a folder next to it.

    Raises
    ------
    InputError
        When one cannot be written.
    """
    targets = [Path(os.path.realpath(path) if os.path.islink(path) else path) for path in paths]
    for path in targets:
        _require_replaceable(path)
    with ExitStack() as folders:
        moves = {_beside(path, folders) / path.name: path for path in targets}
        try:
            yield list(moves)
            _put_in_place({place: path for place, path in moves.items() if os.path.lexists(place)})
        except InputError as problem:
            sentence = str(problem)
            for place, path in moves.items():
                sentence = sentence.replace(str(place), str(path))
            raise InputError(sentence) from problem
        except OSError as problem:
            if where := _written_where(problem, moves):
                raise InputError(f"{where} cannot be written: {problem.strerror or problem}") from problem
            raise


def _require_replaceable(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path} is a folder that exists already: choose another name, or remove it")
    if os.path.lexists(path) and not path.is_file():
        raise InputError(f"{path} is not a regular file: choose another name")


def _beside(path: Path, folders: ExitStack) -> Path:
    """Return a folder as of `unfinished`, which the stack removes, or say that there can be none."""
    try:
        return folders.enter_context(unfinished(path))
    except OSError as problem:
        raise InputError(f"{path} cannot be written: {problem.strerror} ({path.parent})") from None


def _written_where(problem: OSError, moves: Mapping[Path, Path]) -> str:
    """Return the paths to which writing failed; empty where the error is of another file."""
    if problem.filename is None:
        return " or ".join(map(str, moves.values()))
    return next((str(path) for place, path in moves.items() if str(problem.filename).startswith(str(place.parent))), "")


@contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Give an empty folder next to a path, removed with the block; leftovers of killed processes are removed first.

    Parameters
    ----------
    path : Path
        Of what will be written in the folder.

    Raises
    ------
    OSError
        When no folder can be made there.
    """
    remove_unfinished(path)
    with ExitStack() as stack:
        with postponed():
            folder, holder = _make_folder(path)
            stack.callback(_remove, folder, holder)
        yield folder


def _remove(folder: Path, holder: int) -> None:
    with postponed():
        os.close(holder)  # removing needs two descriptors, and there may be no other
        shutil.rmtree(folder, ignore_errors=True)


def _make_folder(path: Path) -> tuple[Path, int]:
    """Return a new folder, and the descriptor that locks it."""
    while True:
        folder = Path(mkdtemp(prefix=f".{path.name}.", suffix=UNFINISHED, dir=path.parent))
        # Before it is held, another process that writes to the same path may take it for left over.
        with suppress(BlockingIOError, FileNotFoundError):
            return folder, hold(folder)


def temporary_place() -> Path:
    """Return the path next to which `unfinished` gives folders for temporary data."""
    return Path(gettempdir(), "tam")


def remove_unfinished(path: Path) -> None:
    """Remove the folders that `unfinished` gave next to a path to processes that have ended.

    Raises
    ------
    OSError
        When the folder of the path cannot be read.
    """
    for name in os.listdir(path.parent):
        if name.startswith(f".{path.name}.") and name.endswith(UNFINISHED):
            remove_left_over(path.with_name(name))


def remove_left_over(folder: Path) -> None:
    """Remove a folder in which a process that is gone has written; one that a process still locks stays.

    Parameters
    ----------
    folder : Path
        The folder; an older folder that was moved into it, to make room for a newer one that never came, goes back.
    """
    with suppress(OSError):
        holder = hold(folder)
        try:
            for older in folder.glob(f"*{_OLDER}"):
                place = folder.with_name(older.name.removesuffix(_OLDER))
                if older.is_dir() and not os.path.lexists(place):
                    os.rename(older, place)
            shutil.rmtree(folder)
        finally:
            os.close(holder)


def hold(path: Path) -> int:
    """Hold a file or folder until the descriptor that is returned is closed, or this process ends.

    Parameters
    ----------
    path : Path
        Of the file or folder.

    Raises
    ------
    BlockingIOError
        When another process has locked it.
    FileNotFoundError
        When it is not there, or was replaced.
    """
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not os.path.samestat(os.fstat(descriptor), os.stat(path)):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _put_in_place(moves: Mapping[Path, Path], replaces_folders: bool = False) -> None:
    """Move files or folders to their places, all or none, once all that they hold is on the disk; a signal waits.

    Raises
    ------
    OSError
        When one cannot be moved, as where a folder has appeared that is not to be replaced; all is then as it was.
    """
    with postponed(), ExitStack() as undo:
        for place in moves:
            for part in (*place.rglob("*"), place):
                _sync(part)
        for place, path in moves.items():
            older = place.with_name(f"{path.name}{_OLDER}")
            if path.is_dir() and replaces_folders:
                shutil.copymode(path, place)
                os.rename(path, older)
                undo.callback(os.rename, older, path)
            elif os.path.lexists(path) and not path.is_dir():
                shutil.copymode(path, place)
                _keep(path, older)
                undo.callback(os.replace, older, path)
            os.replace(place, path)
            undo.callback(os.replace, path, place)
        for folder in {path.parent for path in moves.values()}:
            _sync(folder)
        undo.pop_all()


def _keep(path: Path, older: Path) -> None:
    """Give a file a second name."""
    try:
        os.link(path, older)
    except OSError:  # a file system without hard links
        shutil.copy2(path, older)


def replace_folder(place: Path, path: Path) -> None:
    """Move a folder to its place once all that it contains is on the disk; an older one there makes room for it.

    That is removed with the folder that the newer one comes from, in which it waits until that is in place.

    Parameters
    ----------
    place : Path
        Where it is, in a folder that `unfinished` gave.
    path : Path
        Where it shall be.

    Raises
    ------
    OSError
        When it cannot be moved; all is then as it was.
    """
    _put_in_place({place: path}, replaces_folders=True)


def _sync(path: Path) -> None:
    """Wait until a file, or the list of what a folder contains, is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as problem:
        if problem.errno != errno.EINVAL:  # as of a file system that cannot wait
            raise
    finally:
        os.close(descriptor)


@contextmanager
def in_file(path: Path | str) -> Iterator[None]:
    """Put the name of a file, or of a topic, before the message of an `InputError` that does not begin with it."""
    try:
        yield
    except InputError as problem:
        sentence = str(problem)
        raise InputError(sentence if sentence.startswith((f"{path} ", f"{path}:")) else f"{path}: {sentence}") from None


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Tell in one sentence that a file cannot be read, or is no text file.

    Parameters
    ----------
    path : Path
        The file that the body reads.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    try:
        yield
    except OSError as problem:
        raise InputError(f"{path} cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None


MOST_BYTES = 1 << 26
"""Of a file that is read at once, 64 MiB: four times the largest calibration, a century of an observatory's hours."""


def require_regular(path: Path) -> None:
    """Check that what is to be read is a regular file, or a folder with no other things in it.

    A device may have no end, and a pipe no beginning.

    Parameters
    ----------
    path : Path
        A link is followed.

    Raises
    ------
    InputError
        When it is something else, or leads nowhere.
    """
    with readable(path):
        path.stat()
        parts = list(path.iterdir()) if path.is_dir() else []
    for each in (path, *parts):
        if each.exists() and not (each.is_file() or each.is_dir()):
            raise InputError(f"{each} is no regular file but a device, pipe or socket: copy what it gives into a file")


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        When there is no such file, it cannot be read, is too long, empty or not text.
    """
    require_regular(path)
    with readable(path):
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path} has {path.stat().st_size} bytes, and at most {MOST_BYTES} are read of a text")
        text = path.read_text(encoding="utf-8-sig")
    if not text.strip():
        raise InputError(f"{path} is empty")
    return text


def check_writable(path: str) -> None:
    """Check that a file could be written; an empty path is none.

    Raises
    ------
    InputError
        When its folder is not there or cannot be written to, or it is no file itself.
    """
    folder = Path(path).parent
    if not path:
        return
    if Path(path).is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if Path(path).exists() and not Path(path).is_file():
        raise InputError(f"{path} is no regular file but a device, pipe or socket: name a file")
    if not folder.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{path} cannot be written: {folder} is write-protected")


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Give a place to write a file or folder to, and move it to its path as `write_set` does.

    Parameters
    ----------
    path : Path
        Where the file or folder shall be.

    Yields
    ------
    Path
        Path of the same name in a temporary folder next to the target.

    Raises
    ------
    InputError
        When the target cannot be written.
    """
    with write_set([path]) as [temporary]:
        yield temporary


def write_text(path: Path, text: str) -> None:
    """Write a text file, completely or not at all.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def to_json(content: Mapping[str, Any]) -> str:
    """Return JSON text; NaN and infinity, which JSON has not, become null."""
    plain = json.loads(json.dumps(content), parse_constant=lambda name: None)
    return json.dumps(plain, ensure_ascii=False, indent=1)


def configuration_folder() -> Path:
    """Return the folder ``config/`` that belongs to this package, however it was installed.

    In a source tree, to which an editable install and ``colcon build --symlink-install`` lead too, it is next to the
    package. Any other install has it in ``share/tam_calibration/config`` of a folder above the package, as
    ``/usr/share/tam_calibration/config`` for ``/usr/lib/python3/dist-packages/tam_calibration``.

    Raises
    ------
    InputError
        When it is in none of these places.
    """
    package = Path(__file__).resolve().parents[1]
    places = [package.parent / "config", *(folder / "share" / package.name / "config" for folder in package.parents)]
    for place in places:
        if (place / "tam.yaml").is_file():  # another package's folder may have the name config too
            return place
    raise InputError(
        f"the folder config is missing: it is neither next to {package}, nor share/{package.name}/config above it; "
        f"install {package.name} again"
    )
