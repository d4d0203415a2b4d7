"""Constants of the CUSUM on the squared prediction error, equation (9)."""


def cusum_constants(sigma0_N: float, sigma1_N: float) -> tuple[float, float]:
    """Drift nu and threshold gamma [N^2] of equation (9).

    Args:
        sigma0_N: Standard deviation of the error in the standard case.
        sigma1_N: Standard deviation of the error at an abrupt change.

    Returns:
        nu = (sigma1^2 + sigma0^2) / 2 and gamma = (sigma1^2 - sigma0^2) / 2.
    """
    var0, var1 = sigma0_N * sigma0_N, sigma1_N * sigma1_N
    return (var1 + var0) / 2.0, (var1 - var0) / 2.0
