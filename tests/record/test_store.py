"""The three kinds of store hold the same episodes, and every way of naming one reads it."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from coordlog.catalog.gather import gather
from coordlog.catalog.index import Catalog
from coordlog.catalog.query import ask
from coordlog.catalog.selection import select
from coordlog.catalog.summary import summary
from coordlog.errors import StorageError
from coordlog.record import manifest
from coordlog.record.dataset import find_files
from coordlog.record.dataset import open as open_logs
from coordlog.record.reader import read_header
from coordlog.record.spool import Spool
from coordlog.record.store import LocalStore, ObjectStore, PackStore, Store, store_of
from tests.record.s3 import ENVIRONMENT, Server

FILES = sorted((Path(__file__).parents[1] / "data" / "v1" / "table").glob("*.mcap"))


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.stop()


@pytest.fixture(params=["folder", "pack", "objects"])
def store(
    request: pytest.FixtureRequest,
    server: Server,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Store:
    """The fixtures in each kind of store."""
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.url)
    address = {
        "folder": str(tmp_path / "logs"),
        "pack": str(tmp_path / "PACK"),
        "objects": f"s3://robots/{request.node.name}",
    }[request.param]
    kinds = {"folder": LocalStore, "pack": PackStore, "objects": ObjectStore}
    with kinds[request.param](address) as filled:
        for path in FILES:
            filled.publish(path.name, Path(shutil.copy(path, tmp_path / path.name)))
    return store_of(address)


def test_the_same_bytes_under_every_kind_of_address(store: Store) -> None:
    entries = store.list()
    assert [entry.name.split("/")[-1] for entry in entries] == [path.name for path in FILES]
    for entry, path in zip(entries, FILES, strict=True):
        assert store.read(entry.name) == path.read_bytes()
        assert entry.size == path.stat().st_size


def test_an_address_goes_wherever_a_folder_goes(store: Store) -> None:
    wanted = open_logs(FILES)
    for address in (store.address, Path(store.address)):
        assert len(find_files(address).paths) == len(FILES)
        for got, episode in zip(open_logs(address), wanted, strict=True):
            assert got.result == episode.result
        rows, expected = summary(gather([address])).rows, summary(gather(FILES)).rows
        assert [row.size for row in rows] == [row.size for row in expected]
    path = store.path(store.list()[0].name)
    assert read_header(path) == wanted[0].header
    assert len(open_logs(path)) == 1


def test_a_name_that_is_taken_is_refused_and_the_file_stays(store: Store, tmp_path: Path) -> None:
    kept = tmp_path / "again.mcap"
    kept.write_bytes(b"other")
    with store, pytest.raises(StorageError, match=FILES[0].name):
        store.publish(FILES[0].name, kept)
    assert kept.read_bytes() == b"other"
    assert len(store.list()) == len(FILES)


def test_nothing_there_is_said(store: Store) -> None:
    with pytest.raises(StorageError, match=r"nothing\.mcap"):
        store.read(
            "shard-000000.tar/nothing.mcap" if isinstance(store, PackStore) else "nothing.mcap"
        )


def test_a_pack_in_a_bucket_is_a_pack(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.url)
    with PackStore(tmp_path / "PACK") as pack:
        for path in FILES:
            pack.publish(path.name, Path(shutil.copy(path, tmp_path / path.name)))
    objects = ObjectStore("s3://robots/packed")
    for path in sorted((tmp_path / "PACK").iterdir()):
        objects.publish(path.name, path)
    store = store_of("s3://robots/packed")
    assert isinstance(store, PackStore)
    names = [entry.name for entry in store.list()]
    server.requests.clear()
    assert store.read(names[1]) == FILES[1].read_bytes()
    gets = [text for text in server.requests if text.endswith(".tar")]
    assert len(gets) == 1
    with pytest.raises(StorageError, match="cannot grow"):
        store.publish("x", FILES[0])


def test_a_catalogue_of_every_kind_of_store_says_the_same(store: Store) -> None:
    catalog = Catalog(store.address)
    assert (catalog.refresh().new, Catalog(store.address).refresh().new) == (len(FILES), 0)
    assert Catalog(store.address).verify() == []
    found = {row["digest"]: row for row in Catalog(store.address).episodes().to_pylist()}
    for path in FILES:
        row = found[hashlib.sha256(path.read_bytes()).hexdigest()]
        assert row["length"] == len(store.open(row["path"]).episode)
    assert len(store.list()) == len(FILES)  # the catalogue's own files are no episodes


def test_a_manifest_finds_its_episodes_in_every_kind_of_store(store: Store, tmp_path: Path) -> None:
    out = tmp_path / "all.manifest"
    manifest.write(out, select(gather([store.address]), out=out))
    assert len(find_files(out).paths) == len(FILES)
    assert {path.name for path in find_files(out).paths} == {path.name for path in FILES}
    rows = ask("select path from episodes", gather([out]).sources).column(0).to_pylist()
    assert sorted(map(Path, rows)) == sorted(store.path(entry.name) for entry in store.list())


def test_what_is_recorded_for_an_object_store_waits_in_the_cache_until_it_is_whole(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {**ENVIRONMENT, "XDG_CACHE_HOME": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.url)
    store = ObjectStore("s3://robots/recorded")
    with Spool(store) as spool:
        assert spool.folder.is_relative_to(tmp_path)
        path = Path(shutil.copy(FILES[0], spool.folder))
        server.requests.clear()
        spool.publish(path)
        assert len(server.requests) == 1
        assert not path.exists()
        server.answers = [403]
        kept = Path(shutil.copy(FILES[1], spool.folder))
        with pytest.raises(StorageError, match="403"):
            spool.publish(kept)
        assert kept.exists()
    with Spool(store) as spool:  # the next one publishes what could not be
        assert [path.name for path in spool.published] == [FILES[1].name]
    assert [entry.name for entry in store.list()] == sorted(path.name for path in FILES[:2])
