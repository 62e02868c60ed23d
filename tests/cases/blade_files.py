"""Files of blades and sections in other programs' formats, written from numbers."""

import math

ROW = "{:23.15E}".format


def matrix(rows):
    return "\n".join(" " + " ".join(map(ROW, row)) for row in rows)


def beamdyn(folder, points, twist, stations, version=5, mu=(1, 2, 3, 4, 5, 6), damp_type=1):
    """Primary and blade file. points (k, 3) m, twist (k,) degrees, stations [(eta, stiffness 6x6,
    mass 6x6)]. version: 1 of the first releases, 5 with modal damping. Returns the primary's path.
    """
    more = "DEFAULT  load_retries - retries\nTrue  RotStates - in the rotating frame\n"
    axis = "\n".join(
        " ".join(map(ROW, (*point, angle))) for point, angle in zip(points, twist, strict=True)
    )
    primary = folder / "beamdyn.dat"
    primary.write_text(
        "------- BEAMDYN INPUT FILE -----\nwritten by a test\n---- SIMULATION CONTROL ----\n"
        f"False  Echo  - copy\n0.0  rhoinf - damping\n{more if version > 1 else ''}"
        f"---- GEOMETRY PARAMETER ----\n1  member_total - members\n{len(points)}  kp_total - points"
        f"\n1 {len(points)}\n kp_xr kp_yr kp_zr initial_twist\n (m) (m) (m) (deg)\n{axis}\n"
        "---- MESH PARAMETER ----\n5  order_elem - order\n---- MATERIAL PARAMETER ----\n"
        '"blade.dat"  BldFile - the blade\n---- OUTPUTS ----\nEND of input file\n'
    )
    modal = "---- Modal Damping ----\n2  n_modes - modes\n0.01 0.02  zeta - of them\n"
    tables = "\n\n".join(
        f"  {eta:.9f}\n{matrix(stiffness)}\n\n{matrix(mass)}" for eta, stiffness, mass in stations
    )
    (folder / "blade.dat").write_text(
        "------- BEAMDYN INDIVIDUAL BLADE INPUT FILE -----\nwritten by a test\n--- Parameters ---\n"
        f"{len(stations)}  station_total - stations\n{damp_type}  damp_type - damping\n"
        "---- Stiffness-Proportional Damping ----\n mu1 mu2 mu3 mu4 mu5 mu6\n (s)"
        f"\n{' '.join(map(str, mu))}\n{modal if version > 1 else ''}"
        f"---- Distributed Properties ----\n{tables}\n"
    )
    return primary


def elastodyn(folder, twist=0.0, flap=2.0, edge=8.0, mass=3.0, length=10.0):
    """Primary, blade and tower file of uniform beams; version 2 has PitchAxis no more."""
    rows = "\n".join(f" {x} 0.25 {twist} {mass} {flap} {edge}" for x in (0.0, 0.5, 1.0))
    (folder / "blade.dat").write_text(
        "------- ELASTODYN INDIVIDUAL BLADE INPUT FILE ---\nwritten by a test\n--- PARAMETERS ---\n"
        "3  NBlInpSt - stations\n1  AdjBlMs - factor\n1  AdjFlSt - factor\n1  AdjEdSt - factor\n"
        "--- DISTRIBUTED ---\nBlFract PitchAxis StrcTwst BMassDen FlpStff EdgStff\n"
        f"(-) (-) (deg) (kg/m) (Nm^2) (Nm^2)\n{rows}\n"
    )
    rows = "\n".join(f" {x} {mass} {flap} {edge}" for x in (0.0, 1.0))
    (folder / "tower.dat").write_text(
        "------- ELASTODYN TOWER INPUT FILE ---\nwritten by a test\n--- PARAMETERS ---\n"
        "2  NTwInpSt - stations\n2  AdjTwMa - factor\n1  AdjFASt - factor\n1  AdjSSSt - factor\n"
        "--- DISTRIBUTED ---\nHtFract TMassDen TwFAStif TwSSStif\n(-) (kg/m) (Nm^2) (Nm^2)\n"
        f"{rows}\n"
    )
    primary = folder / "elastodyn.dat"
    primary.write_text(
        f"------- ELASTODYN INPUT FILE ---\nwritten by a test\n{length + 1.5} TipRad - m\n"
        f'1.5 HubRad - m\n90.0 TowerHt - m\n10.0 TowerBsHt - m\n"blade.dat" BldFile(1) - blade\n'
        '"tower.dat" TwrFile - tower\n'
    )
    return primary


def vabs(folder, stiffness, mass, heading="Timoshenko Stiffness Matrix (1-extension; 2,3-shear)"):
    """The output of a section; about its centre the mass is another."""
    path = folder / "section.sg.K"
    rule = " " + "=" * 40 + "\n\n"
    path.write_text(
        f"\n The 6X6 Mass Matrix\n{rule}{matrix(mass)}\n\n The Mass Center of the Cross Section\n"
        f"{rule} 0.1 0.2\n\n The 6X6 Mass Matrix at the Mass Center\n{rule}"
        f"{matrix([[9.0 * (i == j) for j in range(6)] for i in range(6)])}\n\n {heading}\n{rule}"
        f"{matrix(stiffness)}\n"
    )
    return path


def swiftcomp(folder, stiffness, mass):
    path = folder / "section.sg.k"
    rule = " " + "-" * 40 + "\n"
    path.write_text(
        " The Effective Stiffness Matrix\n" + rule + matrix([[1.0, 0, 0, 0]] * 4)
        + "\n\n The Effective Timoshenko Stiffness Matrix (1-extension; 2,3-shear)\n"
        + rule + matrix(stiffness) + "\n\n Effective Mass Matrix =\n" + rule + matrix(mass) + "\n"
    )  # fmt: skip
    return path


def of_flap_and_edge(flap, edge, GJ=1e4, EA=1e9, x=0.0, y=0.0, m=3.0, centre=(0.0, 0.0)):
    """Stiffness and mass 6x6 in BeamDyn's order, of a section whose stretching stiffness is at
    (x, y) m and its mass at `centre` m.
    """
    K = [[0.0] * 6 for _ in range(6)]
    K[0][0] = K[1][1] = EA / 2
    K[2][2], K[5][5] = EA, GJ
    K[3][3], K[4][4] = edge + EA * y * y, flap + EA * x * x
    K[2][3] = K[3][2] = EA * y
    K[2][4] = K[4][2] = -EA * x
    K[3][4] = K[4][3] = -EA * x * y
    a, b = centre
    M = [[0.0] * 6 for _ in range(6)]
    M[0][0] = M[1][1] = M[2][2] = m
    for i, j, value in ((0, 5, -m * b), (1, 5, m * a), (2, 3, m * b), (2, 4, -m * a)):
        M[i][j] = M[j][i] = value
    M[3][3], M[4][4] = m * (0.01 + b * b), m * (0.01 + a * a)
    M[3][4] = M[4][3] = -m * a * b
    M[5][5] = M[3][3] + M[4][4]
    return K, M


def turned(K, degrees):
    """A 6x6 matrix in the file's axes, of a section turned by this twist (about -z)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    R = [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    T = [[R[i % 3][j % 3] if i // 3 == j // 3 else 0.0 for j in range(6)] for i in range(6)]
    half = [[sum(T[i][k] * K[k][j] for k in range(6)) for j in range(6)] for i in range(6)]
    return [[sum(half[i][k] * T[j][k] for k in range(6)) for j in range(6)] for i in range(6)]
