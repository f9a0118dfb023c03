"""What the test of the guest's registers runs: processes that would spoil each other's numbers."""

import hashlib
import multiprocessing

import numpy as np


def digest(seed: int) -> str:
    """Of a long computation in vector registers."""
    matrix = np.random.default_rng(seed).standard_normal((60, 60))
    basis, total = np.eye(60), 0.0
    for _ in range(200):
        basis, _ = np.linalg.qr(matrix @ basis)
        total += float(np.sin(np.exp(-np.abs(matrix)) * total + 1.0).sum())
    return hashlib.sha256(basis.tobytes() + str(total).encode()).hexdigest()


if __name__ == "__main__":
    with multiprocessing.get_context("fork").Pool(4) as pool:
        print(*pool.map(digest, range(4), chunksize=1))
