"""Stretches of a contour with like features: Ward clustering in which only neighbours on the loop may merge.

Ren 2018, 4.2.5: the number of clusters is the one with the largest Calinski-Harabasz index. k-means and k-medoids,
which know no neighbours, are here for comparison only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from isf_core.types import Array
from numpy.typing import NDArray

Labels = NDArray[np.int64]

ALIKE = 1e-2
"""Largest spread of normalised features on a loop that counts as one cluster (assumed): facets of a mesh alone make
up to 0.004 on a cone, half a degree of wall angle or an arc of 0.5 m beside a straight line makes 0.01."""


@dataclass(frozen=True)
class ClusterOptions:
    """Choices of the clustering.

    Attributes
    ----------
    shortest : points, a cluster has at least so many
    most : largest number of clusters
    count : this many clusters instead of the best number; None: choose
    alike : see :data:`ALIKE`; loops below it are one cluster
    """

    shortest: int = 6
    most: int = 16
    count: int | None = None
    alike: float = ALIKE


def cluster_loop(features: Array, options: ClusterOptions, *, closed: bool = True) -> Labels:
    """(N,) cluster of every point of a loop, numbered from its first point on; ``features`` (N, F) normalised."""
    n = len(features)
    if n < 4 or float(np.ptp(features, axis=0).max()) < options.alike:
        return np.zeros(n, dtype=np.int64)
    merges = _ward_merges(features, closed)
    if options.count is not None:
        return _numbered(_cut(merges, n, min(options.count, n)))
    best, best_index = np.zeros(n, dtype=np.int64), -np.inf
    for count in range(2, min(options.most, n - 1) + 1):
        labels = _cut(merges, n, count)
        if int(np.bincount(labels).min()) < options.shortest:
            continue
        index = calinski_harabasz(features, labels)
        if index > best_index:
            best, best_index = labels, index
    return _numbered(best)


def calinski_harabasz(features: Array, labels: Labels) -> float:
    """CH(K) = [B / (K - 1)] / [W / (n - K)] (Ren 2018 eq. 4-8 to 4-12, clusters weighted by their size)."""
    from sklearn.metrics import calinski_harabasz_score

    return float(calinski_harabasz_score(features, labels))


def k_means(features: Array, count: int) -> Labels:
    """(N,) labels by k-means, for comparison: neighbours need not belong together."""
    from sklearn.cluster import KMeans

    return _numbered(KMeans(count, n_init=4, random_state=0).fit_predict(features).astype(np.int64))


def k_medoids(features: Array, count: int) -> Labels:
    """(N,) labels by k-medoids, for comparison: as k-means, with distances instead of their squares.

    Greedy first choice, then the best exchange of a medoid for a point until none lowers the sum of distances
    (partitioning around medoids, Kaufman and Rousseeuw 1990).
    """
    from scipy.spatial.distance import cdist

    apart = cdist(features, features)
    medoids = [int(np.argmin(apart.sum(axis=0)))]
    while len(medoids) < min(count, len(features)):
        nearest = apart[:, medoids].min(axis=1)
        medoids.append(int(np.argmin(np.minimum(nearest[:, None], apart).sum(axis=0))))
    total = float(apart[:, medoids].min(axis=1).sum())
    while True:
        best = (total, -1, -1)
        for k in range(len(medoids)):
            others = medoids[:k] + medoids[k + 1 :]
            nearest = apart[:, others].min(axis=1) if others else np.full(len(apart), np.inf)
            sums = np.minimum(nearest[:, None], apart).sum(axis=0)
            best = min(best, (float(sums.min()), k, int(np.argmin(sums))))
        if best[0] >= total * (1.0 - 1e-12):
            return _numbered(np.argmin(apart[:, medoids], axis=1).astype(np.int64))
        total, medoids[best[1]] = best[0], best[2]


def stretches(labels: Labels, *, closed: bool = True) -> int:
    """Number of uninterrupted stretches of equal label along the loop."""
    changes = int((labels[1:] != labels[:-1]).sum())
    if closed:
        return max(1, changes + int(labels[0] != labels[-1]))
    return changes + 1


def _ward_merges(features: Array, closed: bool) -> NDArray[np.int64]:
    """(N - 1, 2) merges of the tree, in order; numbers from N on are clusters made before."""
    from scipy.sparse import coo_matrix
    from sklearn.cluster import AgglomerativeClustering

    n = len(features)
    here = np.arange(n if closed else n - 1)
    there = (here + 1) % n
    ring = coo_matrix((np.ones(2 * len(here)), (np.r_[here, there], np.r_[there, here])), shape=(n, n))
    tree = AgglomerativeClustering(n_clusters=None, distance_threshold=0.0, connectivity=ring, linkage="ward")
    return np.asarray(tree.fit(features).children_, dtype=np.int64)


def _cut(merges: NDArray[np.int64], n: int, count: int) -> Labels:
    """(N,) labels 0..count-1 after the first n - count merges."""
    parent = np.arange(2 * n)
    for k, pair in enumerate(merges[: n - count]):
        parent[pair] = n + k
    for node in range(2 * n - 1, -1, -1):  # parents have higher numbers than their children
        parent[node] = parent[parent[node]]
    return np.unique(parent[:n], return_inverse=True)[1].astype(np.int64)


def _numbered(labels: Labels) -> Labels:
    """Labels renumbered in the order in which the loop meets them."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    order = np.empty(len(first), dtype=np.int64)
    order[np.argsort(first)] = np.arange(len(first))
    return order[inverse]
