"""A second place for the folders of runs, at any address that fsspec knows, for machines that share no disk.

The folder of a run is one object there, ``<name>.tar``, put in place as a whole, so that a kill leaves the old one.
"""

from __future__ import annotations

import os
import shutil
import tarfile
import tempfile
from pathlib import Path
from typing import Any, Final

PARTIAL: Final = ".part"


class Store:
    """Folders of runs at an address.

    Attributes:
        address: such as ``s3://bucket/sweep``, ``gs://...``, or ``file:///mnt/shared/sweep``.
    """

    def __init__(self, address: str) -> None:
        """Open it.

        Raises:
            ValueError: fsspec knows no such address, or what it needs for it is not installed.
        """
        import fsspec  # comes with the packages of a sweep

        self.address = address
        try:
            self._files, self._root = fsspec.core.url_to_fs(address)
        except (ValueError, ImportError) as error:
            raise ValueError(f"--store {address}: {error}") from None

    def push(self, folder: Path) -> None:
        """Put the folder of a run there, as it is now.

        Raises:
            OSError: it cannot be written.
        """
        target = self._place(folder.name)
        with tempfile.TemporaryDirectory(prefix="bike-store-") as scratch:
            packed = Path(scratch) / "run.tar"
            with tarfile.open(packed, "w") as archive:
                archive.add(folder, arcname=".")
            self._files.makedirs(self._root, exist_ok=True)
            self._files.put_file(str(packed), target + PARTIAL)
        self._files.mv(target + PARTIAL, target)

    def pull(self, folder: Path) -> bool:
        """Fetch the folder of a run, unless it is here already or there is none.

        Returns:
            Whether it was fetched.

        Raises:
            OSError: it cannot be read. ValueError: it is no such archive.
        """
        source = self._place(folder.name)
        if any(folder.glob("*")) or not self._files.exists(source):
            return False
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            packed = fresh / "run.tar"
            self._files.get_file(source, str(packed))
            try:
                with tarfile.open(packed) as archive:
                    _unpack(archive, fresh)
            except tarfile.TarError as error:
                raise ValueError(f"{source} is no archive of a run ({error})") from None
            packed.unlink()
            for entry in fresh.iterdir():
                os.replace(entry, folder / entry.name)
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
        return True

    def _place(self, name: str) -> Any:
        return f"{self._root.rstrip('/')}/{name}.tar"


def _unpack(archive: tarfile.TarFile, folder: Path) -> None:
    """Write the files of an archive into a folder: none outside of it, no device, no link.

    Python has a filter for this from 3.11.4 on; Debian 12 has 3.11.2.

    Raises:
        tarfile.TarError: there is something else in it.
    """
    root = folder.resolve()
    for entry in archive:
        target = (root / entry.name).resolve()
        if not target.is_relative_to(root) or not (entry.isfile() or entry.isdir()):
            raise tarfile.TarError(f"{entry.name!r} is no file of its own folder")
        if entry.isdir():
            target.mkdir(parents=True, exist_ok=True)
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        content = archive.extractfile(entry)
        assert content is not None  # of a regular file
        with content, target.open("wb") as file:
            shutil.copyfileobj(content, file)
