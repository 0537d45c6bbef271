"""Compiled: sines, cosines and arc tangents of small angles as polynomials, which the compiler puts into vectors."""

from __future__ import annotations

from typing import Any

from cellslam.sim.compiling import njit


@njit(cache=True, error_model="numpy")
def sine(F: Any, x: Any) -> Any:
    """Sine of a small angle, |x| < 0.5, to 1e-11."""
    q = x * x
    return x * (F(1.0) - q * (F(1 / 6) - q * (F(1 / 120) - q * (F(1 / 5040) - q * F(1 / 362880)))))


@njit(cache=True, error_model="numpy")
def cosine(F: Any, x: Any) -> Any:
    """Cosine of a small angle, |x| < 0.5, to 1e-10."""
    q = x * x
    return F(1.0) - q * (F(0.5) - q * (F(1 / 24) - q * (F(1 / 720) - q * F(1 / 40320))))


@njit(cache=True, error_model="numpy")
def arc_tangent(F: Any, t: Any) -> Any:
    """Arc tangent for |t| <= 0.66 to double precision (rational approximation of S. Moshier's Cephes library)."""
    q = t * t
    p = ((-F(0.8750608600031904) * q - F(16.15753718733365)) * q - F(75.00855792314705)) * q - F(122.8866684490136)
    p = p * q - F(64.85021904942025)
    d = (((q + F(24.85846490142306)) * q + F(165.0270098316989)) * q + F(432.8810604912903)) * q + F(485.3903996359137)
    d = d * q + F(194.5506571482614)
    return t + t * q * p / d
