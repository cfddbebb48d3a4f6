"""The best linear estimate from all samples at once, by one dense solution: what a filter must find step by step."""

from __future__ import annotations

import numpy as np
import scipy.linalg


def sampled_by_van_loan(F, G, H):
    """Return Φ and the covariance of the noise over a step H of ξ' = F ξ + G w."""
    N = len(F)
    block = np.block([[-F, G @ G.T], [np.zeros((N, N)), F.T]]) * H
    whole = scipy.linalg.expm(block)
    Phi = whole[N:, N:].T
    return Phi, Phi @ whole[:N, N:]


class Batch:
    """Gaussian ξ_0 … and samples of it. Everything is linear in independent sources: ξ_0, the noises and the samples'.

    nodes: ξ at each instant, as mean (N,) and map of the sources (N, sources).
    """

    def __init__(self, mean, std):
        self.nodes = [(np.array(mean, dtype=float), np.diag(std))]
        self.rows, self.values, self.variances = [], [], []

    @property
    def newest(self):
        return self.nodes[-1]

    def step(self, Phi, Q):
        """Go on by a step with the noise's covariance Q."""
        mean, sources = self.newest
        values, vectors = np.linalg.eigh(Q)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        self.nodes.append((Phi @ mean, np.hstack([Phi @ sources, root])))

    def add(self, direction, variance):
        """Add an independent number of this variance to ξ now, in a direction (N,)."""
        mean, sources = self.newest
        self.nodes[-1] = (mean, np.column_stack([sources, np.sqrt(variance) * direction]))

    def measure(self, node, row, y, variance):
        """Use a sample y = row ξ of an instant, with noise of a variance."""
        mean, sources = self.nodes[node]
        self.rows.append(row @ sources)
        self.values.append(y - row @ mean)
        self.variances.append(variance)

    def _used(self):
        count = self.newest[1].shape[1]
        J = np.zeros((len(self.rows), count))
        for place, row in enumerate(self.rows):
            J[place, : len(row)] = row
        return J, np.array(self.values), J @ J.T + np.diag(self.variances)

    def estimate(self, node=-1):
        """Return mean (N,) and covariance (N,N) of ξ at an instant, given all samples used so far."""
        mean, sources = self.nodes[node]
        J, values, S = self._used()
        all_sources = np.zeros((len(mean), J.shape[1]))
        all_sources[:, : sources.shape[1]] = sources
        if not len(values):
            return mean, all_sources @ all_sources.T
        gain = scipy.linalg.solve(S, J @ all_sources.T, assume_a="pos").T
        return mean + gain @ values, all_sources @ all_sources.T - gain @ J @ all_sources.T

    def log_likelihood(self):
        """Return the logarithm of the density of all samples used so far, but for a constant."""
        _, values, S = self._used()
        return -0.5 * (values @ np.linalg.solve(S, values) + np.linalg.slogdet(S)[1])
