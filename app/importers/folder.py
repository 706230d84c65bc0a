"""A scan's folder, and finding a file in it by the name that a list gives it."""

from __future__ import annotations

import unicodedata
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from app.importers.scan_files import resolve_inside

# Code pages of file names in archives and lists from systems without Unicode; cp437 is how zip readers show them.
_CODE_PAGES = ("utf-8", "gb18030", "shift_jis", "euc_kr", "big5", "cp1252", "cp850", "cp1251")
# A message names so many of the files that are there.
_SHOWN = 3


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _caseless(name: str) -> str:
    return _composed(name).casefold()


_SPELLINGS: tuple[Callable[[str], str], ...] = (_composed, _caseless)


@dataclass(slots=True)
class ScanFolder:
    """Finds files whose names a list spells differently: letters in composed and decomposed form (NFC, NFD), in
    another case, or in another code page. What fits several files is none of them."""

    path: Path
    _names: dict[Path, tuple[str, ...]] = field(default_factory=dict)
    _spelled: dict[Path, list[dict[str, list[str]]]] = field(default_factory=dict)

    def find(self, name: str, where: str) -> Path | None:
        """Return the file that a list names, None where there is none.

        `where` is the place in the list. Raises `InvalidScanError` for paths and links that leave the folder.
        """
        path = resolve_inside(self.path, name, where)
        if path.is_file():
            return path
        found = self.path
        for part in name.replace("\\", "/").split("/"):
            if part in ("", "."):
                continue
            child = self._child(found, part)
            if child is None:
                return None
            found = found / child
        return resolve_inside(self.path, self.name_of(found), where) if found.is_file() else None

    def name_of(self, path: Path) -> str:
        """Return a file's path below the folder, with forward slashes."""
        return path.relative_to(self.path).as_posix()

    def subfolder(self, *names: str) -> Path | None:
        """Return the first of the folders of these names that is there."""
        for name in names:
            child = self._child(self.path, name)
            if child is not None and (self.path / child).is_dir():
                return self.path / child
        return None

    def files_in(self, folder: Path) -> list[Path]:
        """Return the files of a folder in the order of their names, without the hidden ones that macOS leaves."""
        names = (name for name in sorted(self._listing(folder)) if not name.startswith("."))
        return [folder / name for name in names if (folder / name).is_file()]

    def instead(self, name: str) -> str:
        """Return a sentence about what is there where the file `name` was looked for."""
        *folders, last = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
        folder = self.path
        for part in folders:
            child = self._child(folder, part)
            if child is None or not (folder / child).is_dir():
                return self._no_folder(part, folder)
            folder = folder / child
        files = [path.name for path in self.files_in(folder)]
        same_stem = [
            n for n in files if _caseless(n).rpartition(".")[0] == _caseless(last).rpartition(".")[0]
        ]
        same_name = [n for n in files if _caseless(n) == _caseless(last)]
        where = f"the folder {folders[-1]}" if folders else "the scan's folder"
        if len(same_name) > 1:
            return f"{where} has {' and '.join(sorted(same_name))}, and which is meant isn't known"
        if same_stem:
            return f"{where} has {same_stem[0]} instead"
        if not files:
            return f"{where} holds no files"
        return f"{where} holds {len(files)} files, such as {', '.join(files[:_SHOWN])}"

    def _no_folder(self, part: str, parent: Path) -> str:
        names = [name for name in sorted(self._listing(parent)) if (parent / name).is_dir()]
        where = "the scan" if parent == self.path else parent.name
        there = f"it has {', '.join(names[:_SHOWN])}" if names else "it has none"
        return f"{where} has no folder {part}; {there}"

    def _child(self, folder: Path, part: str) -> str | None:
        names = self._listing(folder)
        if part in names:
            return part
        if folder not in self._spelled:
            self._spelled[folder] = [_grouped(names, spelling) for spelling in _SPELLINGS]
        for spelling, groups in zip(_SPELLINGS, self._spelled[folder], strict=True):
            fitting = groups.get(spelling(part), [])
            if fitting:
                return fitting[0] if len(fitting) == 1 else None
        return next((name for name in _in_other_code_pages(part) if name in names), None)

    def _listing(self, folder: Path) -> tuple[str, ...]:
        if folder not in self._names:
            try:
                self._names[folder] = tuple(child.name for child in folder.iterdir())
            except OSError:
                self._names[folder] = ()
        return self._names[folder]


def _grouped(names: tuple[str, ...], spelling: Callable[[str], str]) -> dict[str, list[str]]:
    groups = defaultdict(list)
    for name in names:
        groups[spelling(name)].append(name)
    return groups


def _in_other_code_pages(name: str) -> Iterator[str]:
    """Yield what a name would be if one of the two was read in the wrong code page; nothing for plain ASCII."""
    if name.isascii():
        return
    for page in _CODE_PAGES:
        for written, read in ((page, "cp437"), ("cp437", page)):
            try:
                yield _composed(name.encode(written).decode(read))
            except UnicodeError:
                continue
