"""The other rigs run from mesh to scan at half resolution, as ``synthgen bench rigs`` shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import rigs

pytestmark = pytest.mark.slow

# A dense field of a body at these voxels would take 3 GB by itself.
MOST_MB = 3000
# Largest RMS, largest 99 % quantile (millimetres), least share of what is seen that the scan has,
# fewest vertices.
BOUNDS = {
    "body22": (1.2, 4.0, 0.97, 200_000),
    "head6": (0.4, 1.1, 0.98, 45_000),
    "foot10": (0.36, 1.3, 0.98, 38_000),
    "consumer": (1.2, 3.0, 0.8, 3_500),
}


@pytest.mark.parametrize("case", rigs.RUNS, ids=lambda case: case[0])
def test_smoke_mesh_to_scan(case: tuple[str, str, float], tmp_path: Path) -> None:
    name, _, voxel_mm, units, vertices, rms, p99, seen, _, _, peak = rigs.row(*case, tmp_path)
    working, of = (int(n) for n in units.split("/"))
    most_rms, most_p99, least_seen, fewest = BOUNDS[name]
    assert working == of, "every unit measures something"
    assert rms < most_rms
    assert p99 < most_p99
    assert seen > least_seen
    assert vertices > fewest
    assert voxel_mm == 1e3 * case[2]
    assert peak < MOST_MB
    assert (tmp_path / f"{name}_scan.png").is_file()
    assert (tmp_path / f"{name}.glb").stat().st_size > 100_000
