"""A selection is its episodes, in no order; editing it is arithmetic of sets and touches no file."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordlog.catalog.gather import gather
from coordlog.catalog.selection import Split, difference, select
from coordlog.errors import ConfigError, FormatError, SpecError, StorageError
from coordlog.record import manifest
from coordlog.record.addresses import expand
from coordlog.record.files import find_files
from coordlog.record.manifest import Chosen, Manifest
from tests.catalog.logs import write

DIGESTS = st.text("0123456789abcdef", min_size=4, max_size=4)
NAMES = st.text(st.characters(blacklist_categories=["Cs", "Cc"]), max_size=8)
CHOSEN = st.builds(
    Chosen, DIGESTS, NAMES, NAMES, st.integers(0, 2**40), st.integers(0, 2**60), NAMES
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "logs"
    for number in range(30):
        write(folder / f"{number:02}.mcap", number)
    return folder


@pytest.fixture
def logs(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "logs"))


def digests(chosen: Manifest) -> set[str]:
    return {each.digest for each in chosen.chosen}


@given(st.lists(CHOSEN, max_size=8), st.randoms())
def test_a_manifest_is_read_as_written_and_its_hash_knows_no_order(rows, random) -> None:
    written = Manifest("x", tuple(rows), about={"where": "clean"})
    read = manifest.decode(manifest.encode(written))
    assert sorted(read.chosen) == sorted(written.chosen)
    assert (read.name, read.version, read.about) == ("x", 1, {"where": "clean"})
    shuffled = list(rows)
    random.shuffle(shuffled)
    moved = [each._replace(path="elsewhere", mtime=0) for each in shuffled]
    assert Manifest("y", tuple(moved)).hash == written.hash
    if rows:
        other = [*shuffled[1:], shuffled[0]._replace(label=shuffled[0].label + "!")]
        assert Manifest("x", tuple(other)).hash != written.hash


def test_a_manifest_that_was_changed_or_cut_off_is_refused(tmp_path: Path) -> None:
    rows = (Chosen("ab", "train", "", 1, 2, "a"), Chosen("cd", "", "", 1, 2, "b"))
    data = manifest.encode(Manifest("x", rows))
    for cut in range(len(data) - 1):
        with pytest.raises(FormatError):
            manifest.decode(data[:cut])
    with pytest.raises(FormatError, match="changed by hand or cut off"):
        manifest.decode(data.replace(b"train", b"test"))
    with pytest.raises(FormatError, match="edition 2; this release reads edition 1"):
        manifest.decode(data.replace(b'manifest": 1', b'manifest": 2'))
    (tmp_path / "a.manifest").write_text("not one")
    with pytest.raises(FormatError, match=r"a\.manifest: not a manifest"):
        manifest.read(tmp_path / "a.manifest")
    with pytest.raises(SpecError, match="tabs or line ends"):
        manifest.encode(Manifest("x", (rows[0]._replace(path="a\tb"),)))


@pytest.mark.parametrize(
    "harm",
    [
        ('"about": {}', '"about": null'),
        ('"about": {}', '"about": [1]'),
        ('"about": {}', '"about": {"sources": 5}'),
        ('"about": {}', '"about": {"sources": [{"a": 1}]}'),
        ('"about": {}', '"about": {"sources": ["\\u0000"]}'),
        ('"name": "x"', '"name": 5'),
        ('"version": 1', '"version": "1"'),
        ('"version": 1', '"version": NaN'),
        ('"parent": ""', '"parent": []'),
        ("\t2\ta", "\t" + "9" * 400 + "\ta"),
        ("\t1\t2\ta", "\t-1\t2\ta"),
        ("\ta\n", "\ta\0b\n"),
    ],
)
def test_a_manifest_whose_values_are_odd_is_damaged(harm: tuple[str, str]) -> None:
    data = manifest.encode(Manifest("x", (Chosen("ab", "", "", 1, 2, "a"),))).decode()
    odd = data.replace(*harm)
    assert odd != data
    said = "damaged or was cut off|head of the manifest: '(about|name|version|parent)': expected"
    with pytest.raises(FormatError, match=said):
        manifest.decode(odd.encode())


def test_a_manifest_nested_without_end_is_none() -> None:
    with pytest.raises(FormatError, match="not a manifest"):
        manifest.decode(b"[" * 100_000)


def test_where_minus_and_merging_are_operations_on_sets(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.manifest"
    whole = select(gather([logs]), out=out)
    clean = select(gather([logs]), where="clean", out=out)
    rest = select(gather([logs]), minus=[clean], out=out)
    assert len(digests(whole)) == 30
    assert digests(clean) | digests(rest) == digests(whole)
    assert not digests(clean) & digests(rest)
    for name, each in (("clean", clean), ("rest", rest)):
        manifest.write(tmp_path / f"{name}.manifest", each)
    both = gather([tmp_path / "clean.manifest", tmp_path / "rest.manifest", logs])
    assert select(both, out=out).hash == whole.hash


def test_copies_are_one_episode_and_unique_keeps_one_of_each(logs: Path, tmp_path: Path) -> None:
    before = select(gather([logs]), out=tmp_path / "x.manifest")
    shutil.copytree(logs, tmp_path / "logs" / "copies", ignore=shutil.ignore_patterns(".catalog"))
    after = select(gather([logs]), out=tmp_path / "x.manifest")
    assert after.hash == before.hash
    assert len(select(gather([logs]), unique="goal", out=tmp_path / "x.manifest").chosen) == 3
    with pytest.raises(ConfigError, match="unknown column 'nothing'"):
        select(gather([logs]), unique="nothing", out=tmp_path / "x.manifest")


def test_a_split_is_whole_and_keeps_equal_goals_together(logs: Path, tmp_path: Path) -> None:
    how = Split.parse("0.5,0.5", by="goal", seed=3)
    chosen = select(gather([logs]), split=how, out=tmp_path / "x.manifest")
    assert len(chosen.chosen) == 30
    seen: dict[str, set[str]] = {}
    rows = gather([logs]).episodes().to_pylist()
    goals = {row["digest"]: row["goal"] for row in rows}
    for each in chosen.chosen:
        seen.setdefault(goals[each.digest], set()).add(each.part)
    assert all(len(parts) == 1 for parts in seen.values())


@given(st.integers(), st.integers(0, 100))
def test_the_part_of_an_episode_depends_on_its_value_alone(value: int, seed: int) -> None:
    how = Split.parse("a=0.3,b=0.7", by="seed", seed=seed)
    assert how.part(value) == Split((0.3, 0.7), ("a", "b"), "seed", seed).part(value)


def test_a_split_has_the_shares_that_were_asked_for() -> None:
    how = Split.parse("0.8,0.1,0.1", by="digest")
    parts = [how.part(str(i)) for i in range(20_000)]
    for name, share in zip(how.parts, how.shares, strict=True):
        assert abs(parts.count(name) / len(parts) - share) < 0.01


@pytest.mark.parametrize(
    "text", ["0.5,0.6", "x", "", "-0.5,1.5", "a=0.5,a=0.5", "0.25,0.25,0.25,0.25"]
)
def test_shares_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--split: expected"):
        Split.parse(text)
    with pytest.raises(ConfigError, match="unknown column 'nothing'"):
        Split.parse("0.5,0.5", by="nothing")


def test_a_manifest_goes_where_a_folder_goes_and_finds_what_has_moved(
    logs: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x.manifest"
    how = Split.parse("0.5,0.5", by="digest")
    manifest.write(out, select(gather([logs]), split=how, out=out))
    everything = find_files(out).paths
    assert sorted(path.resolve() for path in everything) == list(find_files(logs).paths)
    parts = [find_files(f"{out}:{part}").paths for part in ("train", "test")]
    assert sorted((*parts[0], *parts[1])) == sorted(everything)
    with pytest.raises(ConfigError, match=r"unknown part of x\.manifest 'learn'"):
        find_files(f"{out}:learn")
    (logs / "moved").mkdir()
    (logs / "03.mcap").rename(logs / "moved" / "other.mcap")
    (logs / "04.mcap").touch()  # another time, the same bytes
    assert sorted(path.name for path in find_files(out).paths)[-1] == "other.mcap"
    assert len(find_files(out).paths) == 30


def test_episodes_that_are_gone_or_changed_are_listed(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.manifest"
    manifest.write(out, select(gather([logs]), out=out))
    (logs / "03.mcap").unlink()
    data = bytearray((logs / "04.mcap").read_bytes())
    data[-1] ^= 1
    (logs / "04.mcap").write_bytes(data)
    found = expand(out, search=lambda sources: find_files(sources).paths)
    assert found is not None
    assert len(found.paths) == 28
    assert sorted(path.name for path, _ in found.left_out) == ["03.mcap", "04.mcap"]
    assert all(reason.startswith("gone: no file with the sha256") for _, reason in found.left_out)
    assert len([text for text in gather([out]).skipped if "gone" in text.reason]) == 2


def test_versions_follow_one_another_and_none_is_lost(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.manifest"
    first = manifest.write(out, select(gather([logs]), out=out))
    with pytest.raises(StorageError, match="--force"):
        manifest.write(out, first)
    assert manifest.write(out, first, force=True).version == 1
    second = manifest.write(out, select(gather([logs]), where="clean", out=out), force=True)
    assert (second.version, second.parent) == (2, first.hash)
    kept = tmp_path / f"x@{first.hash[:12]}.manifest"
    assert manifest.read(kept).hash == first.hash
    found = difference(gather([kept]), gather([out]))
    assert found.both == len(second.chosen)
    assert len(found.only_a) == 30 - found.both
    assert found.only_b == ()
    assert found.figures["clean"][1] == 1.0


def test_a_label_is_part_of_what_a_selection_is(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.manifest"
    plain = select(gather([logs]), out=out)
    named = select(gather([logs]), label="good", out=out)
    assert digests(plain) == digests(named)
    assert plain.hash != named.hash
