"""tools/fuzz: the corpus is sound, damage of it is the same again, and nothing gets through."""

from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[3] / "tools"
CORPUS = sorted(path for path in (Path(__file__).parent / "corpus").iterdir())


@pytest.fixture(autouse=True)
def as_scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_is_not_damaged_is_read(path, tmp_path):
    import fuzz

    fuzz.read(path)
    fuzz.attempt(tmp_path / path.name, path.read_bytes())  # compiles, which takes its time
    assert fuzz.attempt(tmp_path / path.name, path.read_bytes()) is None


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.name)
def test_what_is_damaged_is_read_or_refused(path, tmp_path):
    import fuzz
    from fuzz_mutations import damaged

    text = path.read_bytes()
    fuzz.attempt(tmp_path / path.name, text)  # compiles
    for number in range(60):
        broken = damaged(text, [text], number)
        assert broken == damaged(text, [text], number)
        assert fuzz.attempt(tmp_path / path.name, broken) is None, number


def test_what_goes_wrong_is_found(tmp_path, monkeypatch):
    import fuzz

    def raising(path: Path) -> None:
        raise ZeroDivisionError("nobody expects this")

    monkeypatch.setattr(fuzz, "read", raising)
    assert "ZeroDivisionError" in fuzz.attempt(tmp_path / "a.log", b"")
