"""Objects that keep a state of their own, each in a process of a cluster or all right here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import Any

from coordlog.errors import ConfigError
from coordlog.parallel import RETRIES, answer_of, cluster, workers


class Crew:
    """Objects that each work on their own, in a process of a cluster or right here, and are all
    asked together.

    What a cluster loses is made again and asked again. A context manager: leaving it calls `close`
    of each.

    Example:
        >>> with Crew(make, 2, jobs="ray") as crew:                   # doctest: +SKIP
        ...     first, second = crew.ask("collect", [(8,), (8,)])
    """

    def __init__(self, make: Callable[[int], Any], count: int, *, jobs: int | str) -> None:
        """Make nothing yet.

        Args:
            make: Makes an object from its number; a module-level function, or a partial of one.
            count: How many.
            jobs: A cluster, see `workers`; any number: here.

        Raises:
            ConfigError: if `jobs` is none.
        """
        self._make, self._count, self._jobs = make, count, workers(jobs)
        self._stack = ExitStack()
        self._ray: Any = None

    def __enter__(self) -> Crew:
        """Make them.

        Raises:
            ConfigError: if there is no such cluster, or it has too few processors.
        """
        with ExitStack() as stack:
            if isinstance(self._jobs, str):
                self._ray = stack.enter_context(cluster(self._jobs))
                there = int(self._ray.cluster_resources().get("CPU", 0))
                if there < self._count:
                    raise ConfigError(
                        f"--jobs {self._jobs}: expected a processor for each of {self._count}"
                        f" collectors, got a cluster of {there}"
                    )
            self._members = [self._made(at) for at in range(self._count)]
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with self._stack:
            if self._ray is None:
                self.ask("close", [()] * self._count)
                return
            closing = [member.call.remote("close") for member in self._members]
            for reference in closing:
                with suppress(self._ray.exceptions.RayError):
                    self._ray.get(reference)

    def ask(
        self,
        name: str,
        arguments: Sequence[tuple[Any, ...]],
        *,
        before: Callable[[int], tuple[Any, ...]] | None = None,
    ) -> list[Any]:
        """What a method of each object answers.

        Args:
            name: The method.
            arguments: For each object.
            before: Name and arguments of what an object that was made again is asked first, by its
                number; None for nothing.

        Raises:
            CoordlogError: if one is lost again and again, or what the method raises.
        """
        if self._ray is None:
            return [
                getattr(member, name)(*given)
                for member, given in zip(self._members, arguments, strict=True)
            ]
        asked = [
            member.call.remote(name, *given)
            for member, given in zip(self._members, arguments, strict=True)
        ]
        return [
            self._answer(at, asked[at], (name, *arguments[at]), before) for at in range(len(asked))
        ]

    def _made(self, at: int) -> Any:
        if self._ray is None:
            return self._make(at)
        return self._ray.remote(num_cpus=1)(_Member).remote(self._make, at)

    def _answer(
        self,
        at: int,
        reference: Any,
        question: tuple[Any, ...],
        before: Callable[[int], tuple[Any, ...]] | None,
    ) -> Any:
        lost = self._ray.exceptions.RayActorError
        for _ in range(RETRIES):
            try:
                return answer_of(self._ray, reference, lost)
            except lost:
                self._members[at] = self._made(at)
                if before is not None:
                    self._members[at].call.remote(*before(at))
                reference = self._members[at].call.remote(*question)
        return answer_of(self._ray, reference)


class _Member:
    """An object in a process of its own."""

    def __init__(self, make: Callable[[int], Any], at: int) -> None:
        self._object = make(at)

    def call(self, name: str, *arguments: Any) -> Any:
        return getattr(self._object, name)(*arguments)
