"""An object is read in one request and created in one, never over another, and a store that is
unwell is said to be so in one sentence."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from coordlog.errors import ConfigError, CoordlogError, StorageError
from coordlog.record.beside import Beside, keep
from coordlog.record.buckets import Bucket
from coordlog.record.places import Folder, is_url, split_url
from tests.record.s3 import ENVIRONMENT, Server


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    running = Server()
    yield running
    running.stop()


@pytest.fixture
def bucket(
    server: Server, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Bucket:
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", server.url)
    server.requests.clear()
    return Bucket(f"s3://robots/{request.node.name}")


def test_one_request_to_publish_and_one_to_read(server: Server, bucket: Bucket) -> None:
    bucket.create("a.mcap", b"123456")
    assert [text.split()[0] for text in server.requests] == ["PUT"]
    server.requests.clear()
    assert bucket.read("a.mcap") == b"123456"
    assert [text.split()[0] for text in server.requests] == ["GET"]
    server.requests.clear()
    assert bucket.read("a.mcap", 2, 3) == b"345"
    assert [text.split()[0] for text in server.requests] == ["GET"]


@pytest.mark.parametrize("kind", ["folder", "bucket"])
def test_places_agree(kind: str, bucket: Bucket, tmp_path: Path) -> None:
    place = Folder(tmp_path) if kind == "folder" else bucket
    assert place.entries() == []
    place.create("b", b"12345")
    place.create("x/a", b"")
    assert [(entry.name, entry.size) for entry in place.entries()] == [("b", 5)]
    assert [(entry.name, entry.size) for entry in place.entries("x")] == [("x/a", 0)]
    assert place.entry("b") == place.entries()[0]
    assert place.entry("nothing") is None
    assert place.read("b", 3) == b"45"
    with pytest.raises(StorageError, match="expected 3 bytes from byte 4 on, got 1"):
        place.read("b", 4, 3)
    with pytest.raises(StorageError, match="exists and is not overwritten"):
        place.create("b", b"other")
    with pytest.raises(StorageError, match=r"no such|No such"):
        place.read("nothing")
    place.remove("b")
    assert place.entries() == []


def test_files_beside_logs_lie_beside_those_of_a_bucket(bucket: Bucket) -> None:
    name = f"{'a' * 64}.msh.zst"
    keep(bucket.address, {name: b"mesh"})
    keep(f"{bucket.address}/deeper", {name: b"mesh"})
    assert [each.name for each in bucket.everything()] == [f"assets/{name}"]
    found = Beside(f"{bucket.address}/deeper/a.mcap")
    assert (found(name), found("none"), found.names()) == (b"mesh", None, [name])


def test_of_two_writers_one_comes_second(bucket: Bucket) -> None:
    said: list[str] = []

    def write(text: bytes) -> None:
        try:
            bucket.create("same", text)
        except StorageError as error:
            said.append(str(error))

    threads = [threading.Thread(target=write, args=(bytes([i]) * 9,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(said) == 7
    assert len(set(bucket.read("same"))) == 1
    assert all("exists and is not overwritten" in text for text in said)


def test_a_lost_answer_is_asked_for_again(server: Server, bucket: Bucket) -> None:
    server.answers = [503, 500]
    bucket.create("a", b"1")
    server.answers = [503]
    assert bucket.read("a") == b"1"
    bucket.create("a", b"1")  # as if the first answer had been lost: its own work is no clash


def test_a_slow_store_is_waited_for(server: Server, bucket: Bucket) -> None:
    bucket.create("a", b"1")
    server.delay = 0.3
    try:
        assert bucket.read("a") == b"1"
    finally:
        server.delay = 0.0


def test_a_store_that_comes_back_has_what_it_had(server: Server, bucket: Bucket) -> None:
    bucket.create("a", b"1")
    server.stop()
    with pytest.raises(
        StorageError, match=r"robots/.*/a: cannot read: .*read from the environment: AWS_"
    ):
        bucket.read("a")
    server.start()
    assert bucket.read("a") == b"1"


def test_a_store_that_refuses_is_quoted(server: Server, bucket: Bucket) -> None:
    server.answers = [403]
    with pytest.raises(StorageError, match=r"list: http://\S+ answers 403 Forbidden; .*AWS_ACCESS"):
        bucket.entries()
    with pytest.raises(StorageError, match=r"answers 404 Not Found, NoSuchBucket: The spec"):
        Bucket("s3://elsewhere/x").entries()


@pytest.mark.parametrize(
    ("endpoint", "reason"),
    [
        ("http://127.0.0.1:1", r"http://127.0.0.1:1: nobody listens there \(asked 6 times\)"),
        ("https", "does not speak TLS; is it http://"),
        ("127.0.0.1:1", "AWS_ENDPOINT_URL: expected an address like https://HOST:PORT, got 127"),
    ],
    ids=["closed", "no-tls", "no-address"],
)
def test_a_store_that_cannot_be_reached_is_told_of(
    endpoint: str, reason: str, server: Server, bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = server.url.replace("http", "https") if endpoint == "https" else endpoint
    monkeypatch.setenv("AWS_ENDPOINT_URL", there)
    with pytest.raises(CoordlogError, match=reason) as caught:
        Bucket(bucket.address).read("a")
    assert "\n" not in str(caught.value)


def test_a_key_that_is_none_is_refused_and_not_told(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret\n")
    with pytest.raises(ConfigError, match="AWS_SECRET_ACCESS_KEY: expected one line") as caught:
        Bucket(bucket.address)
    assert "secret" not in str(caught.value)


def test_addresses_are_taken_with_one_slash_or_two() -> None:
    assert split_url(Path("s3://robots/a")) == split_url("s3://robots/a") == ("s3", "robots/a")
    assert not is_url("logs/s3:/x")
    for text in ("s3://", "http://x/y", "logs"):
        with pytest.raises(ConfigError, match="expected an address like s3://BUCKET/PREFIX"):
            split_url(text)
