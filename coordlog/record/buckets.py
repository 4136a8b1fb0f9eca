"""A prefix of an object store as a place, through obstore; see `places`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import Any

from coordlog.errors import ConfigError, StorageError
from coordlog.record.places import SCHEMES, Entry, MissingError, require_whole, split_url

_TIMEOUTS: dict[str, Any] = {"connect_timeout": "5s", "timeout": "120s"}
_ENDPOINTS = (
    "AWS_ENDPOINT_URL_S3",
    "AWS_ENDPOINT_URL",
    "AWS_ENDPOINT",
    "AZURE_ENDPOINT",
    "AZURE_STORAGE_ENDPOINT",
    "GOOGLE_BASE_URL",
)
_RETRIES: Any = {
    "max_retries": 5,
    "retry_timeout": timedelta(seconds=30),
    "backoff": {
        "init_backoff": timedelta(milliseconds=100),
        "max_backoff": timedelta(seconds=2),
        "base": 2,
    },
}


class Bucket:
    """A prefix of an object store, such as s3://BUCKET/PREFIX; gs and az likewise.

    Credentials come from the environment's standard places (AWS_ACCESS_KEY_ID and so on); where
    none are set, obstore asks the machine's metadata service. An object is read in one request and
    created in one, on the condition that there is none.

    Example:
        >>> Bucket("s3://robots/logs").read("a.mcap")  # doctest: +SKIP
    """

    def __init__(self, url: str | os.PathLike[str]) -> None:
        """Connect to nothing yet.

        Raises:
            ConfigError: if the address or the environment is not what the library wants.
        """
        scheme, rest = split_url(url)
        self.address = f"{scheme}://{rest}".rstrip("/")
        self._variables = SCHEMES[scheme]
        _require_environment(self._variables[0].partition("_")[0])
        from obstore.exceptions import BaseError
        from obstore.store import from_url

        try:
            self._store = from_url(
                self.address,
                client_options=_options(),
                retry_config=_RETRIES,
            )
        except (BaseError, ValueError) as error:
            raise ConfigError(f"{self.address}: {_brief(error)}") from None

    def entries(self, below: str = "") -> list[Entry]:
        """Objects directly below a prefix, by name, in one request for each thousand."""
        import obstore

        with self._translated(below or self.address, "list"):
            found = obstore.list_with_delimiter(self._store, below or None)["objects"]
        return sorted(map(_entry, found))

    def everything(self) -> list[Entry]:
        """All objects below the prefix, at any depth, by name."""
        import obstore

        with self._translated(self.address, "list"):
            return sorted(_entry(meta) for batch in obstore.list(self._store) for meta in batch)

    def entry(self, name: str) -> Entry | None:
        """One object; None if there is none."""
        import obstore

        try:
            with self._translated(name, "look at"):
                return _entry(obstore.head(self._store, name))
        except MissingError:
            return None

    def read(self, name: str, start: int = 0, size: int | None = None) -> bytes:
        """An object, or a range of it, in one request.

        Raises:
            StorageError: if there is none, or the store refuses or does not answer.
        """
        import obstore

        with self._translated(name, "read"):
            if size is None and not start:
                return bytes(obstore.get(self._store, name).bytes())
            if size is None:
                reply = obstore.get(self._store, name, options={"range": {"offset": start}})
                return bytes(reply.bytes())
            data = bytes(obstore.get_range(self._store, name, start=start, length=size))
        return require_whole(f"{self.address}/{name}", data, start, size)

    def create(self, name: str, data: bytes) -> None:
        """Make an object in one request, unless there is another one of that name.

        A request whose answer was lost is sent again, and then finds its own work: the same bytes
        under the name are no clash.

        Raises:
            StorageError: if the name is taken, or the store refuses or does not answer.
        """
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with self._translated(name, "create"):
            try:
                obstore.put(self._store, name, data, mode="create", use_multipart=False)
            except AlreadyExistsError:
                if self.read(name) != data:
                    raise

    def remove(self, name: str) -> None:
        """Delete an object; none there is no error.

        Raises:
            StorageError: if the store refuses or does not answer.
        """
        import obstore

        with self._translated(name, "delete"):
            obstore.delete(self._store, name)

    @contextmanager
    def _translated(self, name: str, doing: str) -> Iterator[None]:
        """Turn what the store says into one sentence: which object, what it said, what to set."""
        from obstore.exceptions import AlreadyExistsError, BaseError, NotFoundError

        where = name if name.startswith(self.address) else f"{self.address}/{name}"
        try:
            yield
        except AlreadyExistsError:
            raise StorageError(
                f"{where}: the object exists and is not overwritten; choose another name"
            ) from None
        except (NotFoundError, FileNotFoundError):
            raise MissingError(f"{where}: no such object or bucket") from None
        except (BaseError, OSError) as error:
            raise StorageError(
                f"{where}: cannot {doing}: {_brief(error)}; where the store is and who asks is"
                f" read from the environment: {', '.join(self._variables)}"
            ) from None


def _entry(meta: Any) -> Entry:
    return Entry(meta["path"], meta["size"], int(meta["last_modified"].timestamp() * 1e6) * 1000)


def _options() -> Any:
    """Timeouts; without TLS only where the environment names an endpoint without it."""
    plain = any(os.environ.get(name, "").startswith("http://") for name in _ENDPOINTS)
    return {**_TIMEOUTS, "allow_http": plain}


def _require_environment(beginning: str) -> None:
    """Refuse values of variables that the library would end the process for.

    Raises:
        ConfigError: naming the variable; its value may be a secret.
    """
    for name, value in os.environ.items():
        if name.startswith(f"{beginning}_") and not value.isprintable():
            raise ConfigError(f"{name}: expected one line of text, got control characters")
        if name in _ENDPOINTS and value and not re.match(r"https?://[^/\s]+", value):
            raise ConfigError(f"{name}: expected an address like https://HOST:PORT, got {value}")


def _brief(error: BaseException) -> str:
    """What a store said, or why it said nothing, without the library's inner workings."""
    said, _, inside = str(error).partition("\n\nDebug source")
    text = " ".join(said.split())
    if "169.254.169.254" in text:  # where a machine of a cloud asks who it is
        return "no keys are set, and this machine has no role of its own"
    found = _FAILED.search(text)
    if found is None:
        return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} …"
    host, retries, what = found.groups()
    status, body = _STATUS.search(what), _BODY.search(what)
    if status:
        text = f"{host} answers {status[1]}" + (f", {body[1]}: {body[2]}" if body else "")
    else:
        text = f"{host}: {next((why for sign, why in _REASONS if sign in inside), what)}"
    return text + (f" (asked {int(retries) + 1} times)" if retries else "")


_LONGEST = 300
_FAILED = re.compile(r"Error performing \w+ (\w+://[^/\s]+)\S* in \S+(?:, after (\d+) .*?)? - (.*)")
_STATUS = re.compile(r"status code: (\d+ [A-Z][A-Za-z -]*[a-z])")
_BODY = re.compile(r"<Code>([^<]*)</Code>\s*<Message>(.{0,200}?)(?: RequestId:|<)")
_REASONS = (
    ("Connection refused", "nobody listens there"),
    ("dns error", "there is no machine of that name"),
    ("InvalidContentType", "it does not speak TLS; is it http:// instead of https://?"),
    ("TimedOut", "no answer in time"),
)
