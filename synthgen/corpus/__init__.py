"""Plan, shards, manifest and reading of a corpus."""

from synthgen.corpus.reading import Corpus, open_corpus
from synthgen.corpus.sample import Sample, Subject, View

__all__ = ["Corpus", "Sample", "Subject", "View", "open_corpus"]
