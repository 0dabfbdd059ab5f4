"""A corpus is a sequence that data loaders can hand to their workers."""

from __future__ import annotations

from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import fake
import numpy as np
import pytest

from synthgen.config import load_config
from synthgen.corpus import Corpus, open_corpus
from synthgen.corpus.runner import generate


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    out = tmp_path_factory.mktemp("reading") / "c"
    small = ["samples=3", "render.width=48", "render.height=48", "corpus.shard_size=2"]
    generate(load_config("fixtures", small), out, maker=fake.quick, progress=False)
    return open_corpus(out)


def test_properties_workers_of_a_loader_get_what_was_given(corpus: Corpus) -> None:
    """Spawned workers are handed pickles; the corpus is opened again, a view keeps its shard."""
    np.testing.assert_array_equal(
        ForkingPickler.loads(ForkingPickler.dumps(corpus))[2].views[0].image,
        corpus[2].views[0].image,
    )
    sample = ForkingPickler.loads(ForkingPickler.dumps(corpus[1]))
    assert sample.index == 1
    np.testing.assert_array_equal(sample.views[0].image, corpus[1].views[0].image)
    np.testing.assert_array_equal(sample.truth.pose, corpus[1].truth.pose)
    assert len(ForkingPickler.dumps(corpus)) < 1000


def test_smoke_things_say_briefly_what_they_are(corpus: Corpus, tmp_path: Path) -> None:
    sample = corpus[0]
    assert repr(corpus).endswith("c': 3 samples>")
    assert repr(sample) == "<Sample 0: 1 hand(s); views 000000000_00>"
    assert repr(sample.views[0]).startswith("<View 000000000_00: ")
    assert sample.truth.hand in repr(sample.truth) and "cc0-hand" in repr(sample.truth)


def test_edge_positions_are_whole_numbers(corpus: Corpus) -> None:
    assert corpus[-1].index == corpus[np.int64(2)].index == 2
    with pytest.raises(IndexError, match="sample 3 of a corpus of 3"):
        corpus[3]
    for wrong in (slice(0, 2), "0", 1.0):
        with pytest.raises(TypeError, match="one whole number picks one sample"):
            corpus[wrong]  # type: ignore[index]
