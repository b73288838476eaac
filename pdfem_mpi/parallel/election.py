"""Owners of numbered things that several ranks know, elected through a directory that is dealt out over the ranks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.parallel.directory import Exchange

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


def elect(comm: Intracomm, ids: np.ndarray, claims: np.ndarray) -> np.ndarray:
    """Owner of each thing: the rank with the largest claim on it, of equal ones the lowest rank. Collective.

    Rank ``id % size`` collects the claims on a thing and answers; no rank has a table of all.

    Parameters
    ----------
    ids : int64, shape (n,)
        What this rank claims, each once.
    claims : int64, shape (n,)

    Returns
    -------
    int64, shape (n,)
    """
    exchange = Exchange(comm, ids % comm.size)
    heard = exchange.there(np.stack([ids, claims], axis=1))
    return exchange.back(_largest_claims(heard, exchange.source))


def told(comm: Intracomm, ids: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """What ranks say that this one owns; int64, rising, each once. Collective.

    Parameters
    ----------
    ids, owner : int64, shape (n,)
        What this rank knows, and whose it is.
    """
    return np.unique(Exchange(comm, owner).there(ids))


def _largest_claims(heard: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Owner of the thing of each claim heard, int64 (n,), by claims (n, 2) and who made them."""
    order = np.lexsort((rank, -heard[:, 1], heard[:, 0]))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(heard[order, 0]) != 0
    best = order[first]
    answers = np.empty(len(order), np.int64)
    answers[order] = rank[best][np.cumsum(first) - 1]
    return answers
