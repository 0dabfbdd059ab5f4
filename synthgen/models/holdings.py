"""Turn what a model pickle holds into plain arrays: numpy, chumpy and scipy objects alike."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import ModelError
from synthgen.models.holders import ArrayHolder, DtypeHolder, Holder, Token

MAX_DEPTH = 8
MAX_DIMENSIONS = 4
MAX_ITEMS = 10**6


class Budget:
    """Bytes that a file may still make us allocate beyond its own size."""

    def __init__(self, limit: int) -> None:
        self.limit = self.left = limit

    def spend(self, n: int, what: str) -> None:
        """Pay for ``n`` bytes.

        Raises
        ------
        ModelError
            If the file asks for more than a model file of its size can need.
        """
        if n < 0 or n > self.left:
            raise ModelError(
                f"{what} of {n} bytes is more than the {self.left} that are left for copies; "
                "no model file of this size needs them"
            )
        self.left -= n


def plain(value: Any, budget: Budget) -> Any:
    """Turn holders into arrays, through lists, tuples and dicts.

    Parameters
    ----------
    value : object
        As the pickle machine made it.
    budget : Budget
        Pays for every copy.

    Returns
    -------
    object
        Arrays, text, bytes, numbers and containers of them; nothing of the file's classes.

    Raises
    ------
    ModelError
        If something is nested too deep, too large or inconsistent.
    """
    return _Reader(budget).read(value, 0)


@dataclass(frozen=True, eq=False)
class _Read:
    """A value, its result, and what the result would be with every reference followed."""

    value: Any
    result: Any
    height: int
    items: int


class _Reader:
    """One pass over the values; what was read once is not read (nor paid for) again."""

    def __init__(self, budget: Budget) -> None:
        self.budget = budget
        self.known: dict[int, _Read] = {}

    def read(self, value: Any, depth: int) -> Any:
        return self._extent(value, depth).result

    def _extent(self, value: Any, depth: int) -> _Read:
        if isinstance(value, Token):
            raise ModelError(f"holds a class ({value.kind}) where a value should be")
        if isinstance(value, memoryview):
            self.budget.spend(len(value), "a byte string")
            return _Read(value, bytes(value), 0, 1)
        if not isinstance(value, Holder | list | tuple | dict):
            return _Read(value, value, 0, 1)
        if depth > MAX_DEPTH:
            raise ModelError(f"nested deeper than {MAX_DEPTH} levels; no model file is")
        known = self.known.get(id(value))
        if known is None:  # the value is kept too: its id must not be given to another
            known = self.known[id(value)] = self._read(value, depth + 1)
        if known.height > MAX_DEPTH or known.items > MAX_ITEMS:
            raise ModelError(
                f"nested deeper than {MAX_DEPTH} levels, or lists of more than {MAX_ITEMS} items; "
                "no model file has them"
            )
        return known

    def _read(self, value: Any, depth: int) -> _Read:
        if isinstance(value, dict):
            parts = {key: self._extent(item, depth) for key, item in value.items()}
            return _over(value, {k: part.result for k, part in parts.items()}, parts.values())
        if isinstance(value, list | tuple):
            inner = [self._extent(item, depth) for item in value]
            return _over(value, [part.result for part in inner], inner)
        if isinstance(value, ArrayHolder):
            return self._array(value, depth)
        if isinstance(value, DtypeHolder) or not isinstance(value.state, dict):
            raise ModelError(f"a {value.kind} in the file has no content")
        form = self._sparse if value.kind.startswith("sparse ") else self._chumpy
        return _Read(value, form(value, depth), 0, 1)

    def _array(self, holder: ArrayHolder, depth: int) -> _Read:
        if holder.state is None:
            raise ModelError("an array in the file has no content")
        shape, dtype, fortran, data = holder.state
        if not isinstance(dtype, DtypeHolder):
            raise ModelError("an array in the file has no dtype")
        shape = _shape(shape, "an array")
        if dtype.holds_objects:
            return self._objects(holder, shape, data, depth)
        if isinstance(data, str):
            self.budget.spend(len(data), "an array's text")
        raw = data.encode("latin1") if isinstance(data, str) else data
        kind = dtype.numpy()
        if not isinstance(raw, bytes | memoryview):
            raise ModelError(f"an array of shape {shape} has no data")
        if math.prod(shape) * kind.itemsize != len(raw):
            raise ModelError(
                f"an array of shape {shape} and dtype {kind} has {len(raw)} bytes, which does "
                "not match its bytes"
            )
        flat = np.frombuffer(raw, dtype=kind) if len(raw) else np.zeros(0, dtype=kind)
        shaped = flat.reshape(shape, order="F" if fortran else "C")
        if kind.isnative:
            return _Read(holder, shaped, 0, 1)
        self.budget.spend(flat.nbytes, "an array of foreign byte order")
        return _Read(holder, shaped.astype(kind.newbyteorder("=")), 0, 1)

    def _objects(self, holder: Holder, shape: tuple[int, ...], data: Any, depth: int) -> _Read:
        """Return an array of objects as a list, or the object of one without dimensions."""
        if not isinstance(data, list) or len(data) != math.prod(shape) or len(shape) > 1:
            raise ModelError(f"an array of objects of shape {shape} has no such items")
        inner = [self._extent(item, depth) for item in data]
        items = [part.result for part in inner]
        return _over(holder, items if shape else items[0], inner)

    def _chumpy(self, holder: Holder, depth: int) -> NDArray[Any]:
        state = holder.state
        if holder.kind == "chumpy ch":
            key = "x" if "x" in state else "_x"
            value = self._member(state, key, holder, depth)
            number = isinstance(value, int | float)
            return _numeric(np.asarray(value) if number else value, holder)
        source = _numeric(self._member(state, "a", holder, depth), holder)
        if holder.kind == "chumpy select":
            picks = self._integers(self._member(state, "idxs", holder, depth), holder).ravel()
            if picks.size and (picks.min() < 0 or picks.max() >= source.size):
                raise ModelError(f"a chumpy Select picks item {picks.max()} of {source.size}")
            self.budget.spend(picks.size * source.itemsize, "a chumpy Select")
            shape = state.get("preferred_shape")
            found = source.ravel()[picks]
            return found if shape is None else self._reshaped(found, shape, depth)
        if holder.kind == "chumpy transpose":
            axes = state.get("axes")
            order = None if axes is None else [int(k) for k in _sequence(self.read(axes, depth))]
            return source.transpose(order)
        return self._reshaped(source, state.get("newshape"), depth)

    def _reshaped(self, source: NDArray[Any], shape: Any, depth: int) -> NDArray[Any]:
        wanted = _shape(self.read(shape, depth), "a chumpy object")
        if math.prod(wanted) != source.size:
            raise ModelError(f"a chumpy object of {source.size} items has shape {wanted}")
        if not source.flags.c_contiguous:
            self.budget.spend(source.nbytes, "a chumpy object whose items lie apart")
        return source.reshape(wanted)

    def _member(self, state: dict[str, Any], key: str, holder: Holder, depth: int) -> Any:
        if key not in state:
            has = f"{sorted(state)}"
            raise ModelError(f"a {holder.kind} in the file has no {key!r}; it has {has:.200}")
        return self.read(state[key], depth)

    def _sparse(self, holder: Holder, depth: int) -> NDArray[np.float64]:
        """Return a scipy matrix as a dense one; entries that are given twice are summed."""
        state = {k: self.read(v, depth) for k, v in holder.state.items()}
        shape = _shape(state.get("_shape", state.get("shape")), "a sparse matrix")
        if len(shape) != 2:
            raise ModelError(f"a sparse matrix of shape {shape} is no joint regressor")
        self.budget.spend(8 * math.prod(shape), f"a sparse matrix of shape {shape}")
        values = _numeric(self._member(state, "data", holder, depth), holder)
        if holder.kind == "sparse coo":
            pair = state.get("coords") or [state.get("row"), state.get("col")]
            row, column = (self._integers(part, holder) for part in pair)
        else:
            inner = self._integers(state.get("indices"), holder)
            outer = _unrolled(self._integers(state.get("indptr"), holder), len(values))
            row, column = (inner, outer) if holder.kind == "sparse csc" else (outer, inner)
        if not len(values) == len(row) == len(column):
            raise ModelError("a sparse matrix has parts of different lengths")
        for part, n in ((row, shape[0]), (column, shape[1])):
            if part.size and (part.min() < 0 or part.max() >= n):
                raise ModelError(f"a sparse matrix of shape {shape} has entries outside")
        dense = np.zeros(shape)
        np.add.at(dense, (row, column), values)
        return dense

    def _integers(self, value: Any, holder: Holder) -> NDArray[np.int64]:
        """Return indices; a list of them may be named by many holders, each makes a copy."""
        if isinstance(value, list) and not all(isinstance(n, int) for n in value):
            raise ModelError(f"a {holder.kind} in the file has indices that are no whole numbers")
        found = np.asarray(value) if isinstance(value, list) else _numeric(value, holder)
        if found.dtype.kind not in "iu":
            raise ModelError(f"a {holder.kind} in the file has indices of type {found.dtype}")
        self.budget.spend(8 * found.size, "indices")
        return found.astype(np.int64)


def _over(value: Any, result: Any, parts: Iterable[_Read]) -> _Read:
    height, items = 0, 1
    for part in parts:
        height, items = max(height, part.height), items + part.items
    return _Read(value, result, height + 1, items)


def _unrolled(pointer: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Return the outer index of each of ``n`` entries from compressed pointers."""
    # neighbours are compared, not subtracted: differences of 64 bits may wrap, and a wrapped
    # count makes numpy write beyond its array
    falls = (pointer[1:] < pointer[:-1]).any()
    if not len(pointer) or pointer[0] != 0 or pointer[-1] != n or falls:
        raise ModelError("a sparse matrix has broken pointers")
    counts = np.diff(pointer)
    return np.repeat(np.arange(len(counts)), counts)


def _shape(value: Any, what: str) -> tuple[int, ...]:
    numbers = _sequence(value) if value is not None else [-1]
    shape = tuple(int(n) for n in numbers if isinstance(n, int | np.integer))
    if len(shape) != len(numbers) or len(shape) > MAX_DIMENSIONS or any(n < 0 for n in shape):
        raise ModelError(f"{what} in the file has shape {value!r:.60}")
    return shape


def _sequence(value: Any) -> list[Any]:
    if isinstance(value, list | tuple | np.ndarray):
        return list(value)
    raise ModelError("an object in the file has no shape")


def _numeric(value: Any, holder: Holder) -> NDArray[Any]:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
        raise ModelError(f"a {holder.kind} in the file holds no numbers")
    return value
