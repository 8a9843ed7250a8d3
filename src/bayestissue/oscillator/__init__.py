"""The physics: (K, C, M), (omega_n, zeta) and (phi1, phi2, theta1), and the ways between them."""
