/* Explicit dynamics of a thin elasto-plastic sheet between moving tools, on a structured grid of quadrilaterals.
 *
 * Element: four nodes, one point in the plane, five through the thickness; corotational velocity strains, Mindlin shear
 * and hourglass stiffness after Belytschko 1984, with the curvature that a warped element gets from its membrane
 * velocities (Belytschko 1992). Material: J2 plasticity in plane stress, isotropic hardening by a
 * table, return mapping in the eigenvectors of the projection (Simo 1986). Central differences, lumped mass.
 *
 * Arrays are (components, entries), entries fastest; node n = j (nx + 1) + i, element e = j nx + i. SI units.
 * Corners 1 to 4 of element (i, j): (i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1). The layout and the order of the
 * fields of the structs are repeated in library.py.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define VECTORISED __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define VECTORISED
#endif
#define R restrict

enum { LAYERS = 5, POINTS = 8, TOOLS = 2 };

/* Gauss-Legendre points and weights on (-1, 1) */
static const double LEVEL[LAYERS] = {-0.906179845938664, -0.538469310105683, 0.0, 0.538469310105683, 0.906179845938664};
static const double SHARE[LAYERS] = {0.236926885056189, 0.478628670499366, 0.568888888888889, 0.478628670499366,
                                     0.236926885056189};

typedef struct {
    int64_t nx, ny, table_size, support_size;
    /* contact: N/m^3, pressure per depth; contact_time: s, depth that a speed of approach counts as, over that speed */
    double young, poisson, step, damping, table_step, contact, contact_time, friction, slip_speed;
    double *position, *velocity, *spin, *force, *moment; /* (3, nodes) */
    const double *mass, *inertia;                        /* (nodes) */
    const double *spring, *spring_limit;                 /* (nodes) N/m and N of the edge in the plane, 0: none */
    double *anchor;                                      /* (2, nodes) where these springs are free of force */
    const uint8_t *fixed;                                /* (nodes) bits 1, 2, 4: x, y, z; 8: rotations */
    double *thickness, *stress, *plastic_strain;         /* (elements), (LAYERS 3, elements), (LAYERS, elements) */
    double *shear, *hourglass, *plastic_work;            /* (2, elements), (5, elements), (elements) J */
    double *element_force;                               /* (24, elements), scratch */
    const double *flow_stress, *hardening;               /* (table_size) Pa, over the plastic strain */
    const double *area;                                  /* (elements) m^2, undeformed */
    /* a rigid surface under the sheet: heights (support_ny, support_nx) m on a regular grid, -1e9: none */
    int64_t support_nx, support_ny;
    double support_x, support_y, support_spacing;
    double support_from, support_to; /* m by which it stands higher before and after the steps */
    const double *support_height;
    const int32_t *support_element;                      /* (support_size) element of each point that may touch it */
    const double *support_weight, *support_area;         /* (4, support_size) of its corners, (support_size) m^2 */
    int32_t *support_near;                               /* (support_size) scratch */
} Shell;

/* A tool touches the sheet from above (side 1) or from below (side -1): a disc of radius `flat` with a rounding of
 * `radius` around it, a ball where flat is 0. It moves from `begin` to `end` (centres of the rounding, m) and gives way
 * by `compliance` (m/N) under `felt`, the smoothed force of the sheet on it. */
typedef struct {
    double side, radius, flat;
    double begin[3], end[3], compliance[3], felt[3];
    double mean[3];  /* out: force of the sheet on the tool, mean over the steps, N */
    int64_t node[2]; /* nearest node found last, i and j */
    int64_t touching; /* out: contact points in the last step */
} Tool;

#define DOT(a, b) ((a##x) * (b##x) + (a##y) * (b##y) + (a##z) * (b##z))

VECTORISED static void elements(const Shell *R q, int64_t first_row, int64_t rows) {
    const int64_t nx = q->nx, nn = (q->nx + 1) * (q->ny + 1), ne = q->nx * q->ny, last = q->table_size - 2;
    const double young = q->young, nu = q->poisson, dt = q->step;
    const double G = young / (2.0 * (1.0 + nu)), C = young / (1.0 - nu * nu), kappa = 5.0 / 6.0;
    const double bulk = young / (3.0 * (1.0 - nu)), thin = -nu / (1.0 - nu), per_step = 1.0 / q->table_step;
    const double *R px = q->position, *R py = px + nn, *R pz = py + nn;
    const double *R qx = q->velocity, *R qy = qx + nn, *R qz = qy + nn;
    const double *R rx = q->spin, *R ry = rx + nn, *R rz = ry + nn;
    const double *R flow = q->flow_stress, *R hard = q->hardening;
    double *R thickness = q->thickness, *R stress = q->stress, *R strain = q->plastic_strain, *R work = q->plastic_work;
    double *R shear = q->shear, *R hg = q->hourglass, *R out = q->element_force;
    const double *R area = q->area;
    for (int64_t j = first_row; j < first_row + rows; j++) {
        const int64_t below = j * (nx + 1), above = below + nx + 1;
#pragma omp simd
        for (int64_t i = 0; i < nx; i++) {
            const int64_t n1 = below + i, n2 = n1 + 1, n4 = above + i, n3 = n4 + 1, e = j * nx + i;
            /* corotational frame: e3 across both diagonals, e1 and e2 symmetric to the middle lines */
            const double ax = px[n3] - px[n1], ay = py[n3] - py[n1], az = pz[n3] - pz[n1];
            const double bx = px[n4] - px[n2], by = py[n4] - py[n2], bz = pz[n4] - pz[n2];
            double gx = ax - bx, gy = ay - by, gz = az - bz, hx = ax + bx, hy = ay + by, hz = az + bz;
            double norm = 1.0 / sqrt(DOT(g, g));
            gx *= norm, gy *= norm, gz *= norm;
            norm = 1.0 / sqrt(DOT(h, h));
            hx *= norm, hy *= norm, hz *= norm;
            double sx = gx + hx, sy = gy + hy, sz = gz + hz, tx = gx - hx, ty = gy - hy, tz = gz - hz;
            norm = M_SQRT1_2 / sqrt(DOT(s, s));
            sx *= norm, sy *= norm, sz *= norm;
            norm = M_SQRT1_2 / sqrt(DOT(t, t));
            tx *= norm, ty *= norm, tz *= norm;
            const double ux = sx + tx, uy = sy + ty, uz = sz + tz, vx = sx - tx, vy = sy - ty, vz = sz - tz;
            const double wx = uy * vz - uz * vy, wy = uz * vx - ux * vz, wz = ux * vy - uy * vx;
            /* derivatives of the shape functions in the middle, times the area */
            const double x31 = DOT(a, u), y31 = DOT(a, v), x42 = DOT(b, u), y42 = DOT(b, v);
            const double A = 0.5 * (x31 * y42 - x42 * y31), iA = 1.0 / A;
            const double b11 = -0.5 * y42, b12 = 0.5 * y31, b21 = 0.5 * x42, b22 = -0.5 * x31;
            /* corners seen from corner 1, for hourglass shape and warping */
            const double cx = px[n2] - px[n1], cy = py[n2] - py[n1], cz = pz[n2] - pz[n1];
            const double dx = px[n4] - px[n1], dy = py[n4] - py[n1], dz = pz[n4] - pz[n1];
            const double x21 = DOT(c, u), y21 = DOT(c, v), z21 = DOT(c, w);
            const double x41 = DOT(d, u), y41 = DOT(d, v), z41 = DOT(d, w), z31 = DOT(a, w);
            const double lx = x31 - x21 - x41, ly = y31 - y21 - y41;
            const double g1 = 1.0 - iA * (lx * b11 + ly * b21), g2 = -1.0 - iA * (lx * b12 + ly * b22);
            const double g3 = 2.0 - g1, g4 = -2.0 - g2;
            /* warping: z = c xi eta; gradient of the normals' in-plane components, minus the second derivatives of z */
            const double warp = 0.25 * (z31 - z21 - z41);
            const double xi_x = iA * (y31 + y42), xi_y = -iA * (x31 + x42);
            const double eta_x = iA * (y42 - y31), eta_y = iA * (x31 - x42);
            const double pxx = -2.0 * warp * xi_x * eta_x, pyy = -2.0 * warp * xi_y * eta_y;
            const double pxy = -warp * (xi_x * eta_y + xi_y * eta_x);
            /* normals in corners 1 and 2; those of 3 and 4 lean the other way */
            const double px1 = warp * (xi_x + eta_x), py1 = warp * (xi_y + eta_y);
            const double px2 = warp * (xi_x - eta_x), py2 = warp * (xi_y - eta_y);
            /* velocities in the frame; B is antisymmetric in opposite corners, so two differences are enough */
            double mx = qx[n1] - qx[n3], my = qy[n1] - qy[n3], mz = qz[n1] - qz[n3];
            const double u13 = DOT(m, u), v13 = DOT(m, v), w13 = DOT(m, w);
            mx = qx[n2] - qx[n4], my = qy[n2] - qy[n4], mz = qz[n2] - qz[n4];
            const double u24 = DOT(m, u), v24 = DOT(m, v), w24 = DOT(m, w);
            mx = qx[n1] + qx[n3] - qx[n2] - qx[n4], my = qy[n1] + qy[n3] - qy[n2] - qy[n4];
            mz = qz[n1] + qz[n3] - qz[n2] - qz[n4];
            const double us = DOT(m, u), vs = DOT(m, v), ws = DOT(m, w);
            /* velocity gradients */
            const double uxx = (b11 * u13 + b12 * u24) * iA, uxy = (b21 * u13 + b22 * u24) * iA;
            const double vxx = (b11 * v13 + b12 * v24) * iA, vxy = (b21 * v13 + b22 * v24) * iA;
            /* spins; about the normal of its corner each node turns with the element, for nothing else resists there */
            const double turn = 0.5 * (vxx - uxy);
            mx = rx[n1] - rx[n3], my = ry[n1] - ry[n3], mz = rz[n1] - rz[n3];
            double ox = rx[n1] + rx[n3], oy = ry[n1] + ry[n3], oz = rz[n1] + rz[n3];
            double about = DOT(o, w) - 2.0 * turn;
            const double p13 = DOT(m, u) - px1 * about, q13 = DOT(m, v) - py1 * about;
            about = DOT(m, w);
            const double ps13 = DOT(o, u) - px1 * about, qs13 = DOT(o, v) - py1 * about;
            mx = rx[n2] - rx[n4], my = ry[n2] - ry[n4], mz = rz[n2] - rz[n4];
            ox = rx[n2] + rx[n4], oy = ry[n2] + ry[n4], oz = rz[n2] + rz[n4];
            about = DOT(o, w) - 2.0 * turn;
            const double p24 = DOT(m, u) - px2 * about, q24 = DOT(m, v) - py2 * about;
            about = DOT(m, w);
            const double ps24 = DOT(o, u) - px2 * about, qs24 = DOT(o, v) - py2 * about;
            const double pm = 0.25 * (ps13 + ps24), qm = 0.25 * (qs13 + qs24), ps = ps13 - ps24, qs = qs13 - qs24;
            /* curvatures and shear */
            const double xy = uxy + vxx, slope_x = (b11 * w13 + b12 * w24) * iA, slope_y = (b21 * w13 + b22 * w24) * iA;
            const double kx = (b11 * q13 + b12 * q24) * iA - uxx * pxx - 0.5 * xy * pxy;
            const double ky = -(b21 * p13 + b22 * p24) * iA - vxy * pyy - 0.5 * xy * pxy;
            const double kxy = (b21 * q13 + b22 * q24 - b11 * p13 - b12 * p24) * iA
                - (uxx + vxy) * pxy - 0.5 * xy * (pxx + pyy);
            const double sxz = slope_x + qm, syz = slope_y - pm;
            const double qxz = shear[e] += G * sxz * dt, qyz = shear[ne + e] += G * syz * dt;
            /* layers */
            const double h = thickness[e], half = 0.5 * h;
            double Nx = 0.0, Ny = 0.0, Nxy = 0.0, Mx = 0.0, My = 0.0, Mxy = 0.0, ezz = 0.0, done = 0.0;
#pragma GCC unroll 5
            for (int k = 0; k < LAYERS; k++) {
                const double z = half * LEVEL[k], weight = half * SHARE[k];
                const double ex_ = (uxx + z * kx) * dt, ey_ = (vxy + z * ky) * dt, exy = (xy + z * kxy) * dt;
                double *R s = stress + 3 * k * ne, *R ep = strain + k * ne;
                const double trial_x = s[e] + C * (ex_ + nu * ey_), trial_y = s[ne + e] + C * (ey_ + nu * ex_);
                double txy = s[2 * ne + e] + G * exy, sum = trial_x + trial_y, dif = trial_x - trial_y;
                const double before = ep[e];
                int32_t place = (int32_t)(before * per_step);
                place = place < last ? place : (int32_t)last;
                place = place > 0 ? place : 0; /* also where a sheet that has become unstable gives no number */
                const double H = hard[place], Y = flow[place] + H * (before - place * q->table_step);
                const double P = sum * sum * (1.0 / 6.0), Q = 0.5 * dif * dif + 2.0 * txy * txy;
                const double on = 0.5 * (P + Q) > Y * Y * (1.0 / 3.0) ? 1.0 : 0.0;
                double dg = 0.0, d1, d2, square, length;
#pragma GCC unroll 3
                for (int it = 0; it < 3; it++) {
                    d1 = 1.0 / (1.0 + bulk * dg), d2 = 1.0 / (1.0 + 2.0 * G * dg);
                    square = P * d1 * d1 + Q * d2 * d2;
                    length = sqrt(2.0 / 3.0 * square) + 1e-30;
                    const double Yk = Y + H * dg * length;
                    const double slope = -2.0 * (bulk * P * d1 * d1 * d1 + 2.0 * G * Q * d2 * d2 * d2);
                    const double f = 0.5 * square - Yk * Yk * (1.0 / 3.0);
                    const double df = 0.5 * slope - 2.0 / 3.0 * Yk * H * (length + dg * slope / (3.0 * length));
                    dg -= on * f / df;
                    dg = dg > 0.0 ? dg : 0.0;
                }
                d1 = 1.0 / (1.0 + bulk * dg), d2 = 1.0 / (1.0 + 2.0 * G * dg);
                square = P * d1 * d1 + Q * d2 * d2;
                const double more = dg * sqrt(2.0 / 3.0 * square);
                sum *= d1, dif *= d2, txy *= d2;
                const double new_x = 0.5 * (sum + dif), new_y = 0.5 * (sum - dif), plastic = dg * sum * (1.0 / 3.0);
                s[e] = new_x, s[ne + e] = new_y, s[2 * ne + e] = txy, ep[e] = before + more;
                done += weight * more * (Y + 0.5 * H * more);
                ezz += 0.5 * SHARE[k] * (thin * (ex_ + ey_ - plastic) - plastic);
                Nx += weight * new_x, Ny += weight * new_y, Nxy += weight * txy;
                Mx += weight * z * new_x, My += weight * z * new_y, Mxy += weight * z * txy;
            }
            thickness[e] = h * (1.0 + ezz);
            work[e] += done * area[e];
            /* membrane forces with the part of the moments that a warped element turns into them */
            const double Txx = Nx - Mx * pxx - Mxy * pxy, Tyy = Ny - My * pyy - Mxy * pxy;
            const double Txy = Nxy - 0.5 * ((Mx + My) * pxy + Mxy * (pxx + pyy));
            const double Qx = kappa * h * qxz, Qy = kappa * h * qyz;
            /* hourglass stiffness: bending, shear, membrane */
            const double BB = 2.0 * (b11 * b11 + b12 * b12 + b21 * b21 + b22 * b22) * iA * iA * dt;
            const double of_bending = 0.03 / 192.0 * young * h * h * h * A * BB;
            const double of_shear = 0.03 / 12.0 * kappa * G * h * h * h * BB, of_membrane = 0.03 / 8.0 * young * h * A * BB;
            /* gamma . v with g1 + g3 = 2, g2 + g4 = -2; a warped element that turns has membrane velocities of its own */
            const double m1 = g1 - 1.0, m2 = g2 + 1.0;
            const double H1 = hg[e] += of_bending * (ps + m1 * p13 + m2 * p24);
            const double H2 = hg[ne + e] += of_bending * (qs + m1 * q13 + m2 * q24);
            const double H3 = hg[2 * ne + e] += of_shear * (ws + m1 * w13 + m2 * w24);
            const double H4 = hg[3 * ne + e] += of_membrane * (us + m1 * u13 + m2 * u24 + 4.0 * warp * slope_x);
            const double H5 = hg[4 * ne + e] += of_membrane * (vs + m1 * v13 + m2 * v24 + 4.0 * warp * slope_y);
            const double Vx = Qx + 4.0 * warp * iA * H4, Vy = Qy + 4.0 * warp * iA * H5;
#define MOMENTS(I, B1, B2, GAMMA)                                                                                      \
    const double s##I = -(B2)*My - (B1)*Mxy - 0.25 * A * Qy + (GAMMA)*H1;                                              \
    const double t##I = (B1)*Mx + (B2)*Mxy + 0.25 * A * Qx + (GAMMA)*H2;
            MOMENTS(0, b11, b21, g1)
            MOMENTS(1, b12, b22, g2)
            MOMENTS(2, -b11, -b21, g3)
            MOMENTS(3, -b12, -b22, g4)
            const double S = 0.5 * iA * (px1 * (s0 - s2) + py1 * (t0 - t2) + px2 * (s1 - s3) + py2 * (t1 - t3));
#define CORNER(I, B1, B2, GAMMA, PX, PY)                                                                               \
    {                                                                                                                  \
        const double f1 = (B1)*Txx + (B2) * (Txy - S) + (GAMMA)*H4, f2 = (B1) * (Txy + S) + (B2)*Tyy + (GAMMA)*H5;     \
        const double f3 = (B1)*Vx + (B2)*Vy + (GAMMA)*H3, r = -(PX)*s##I - (PY)*t##I;                                  \
        double *R o = out + 6 * (I)*ne;                                                                                \
        o[e] = f1 * ux + f2 * vx + f3 * wx, o[ne + e] = f1 * uy + f2 * vy + f3 * wy;                                   \
        o[2 * ne + e] = f1 * uz + f2 * vz + f3 * wz, o[3 * ne + e] = s##I * ux + t##I * vx + r * wx;                   \
        o[4 * ne + e] = s##I * uy + t##I * vy + r * wy, o[5 * ne + e] = s##I * uz + t##I * vz + r * wz;                \
    }
            CORNER(0, b11, b21, g1, px1, py1)
            CORNER(1, b12, b22, g2, px2, py2)
            CORNER(2, -b11, -b21, g3, -px1, -py1)
            CORNER(3, -b12, -b22, g4, -px2, -py2)
        }
    }
}

/* Internal forces on the nodes, with their sign as they act on the nodes. */
VECTORISED static void assemble(const Shell *R q) {
    const int64_t nx = q->nx, ny = q->ny, nn = (nx + 1) * (ny + 1), ne = nx * ny;
    memset(q->force, 0, sizeof(double) * 3 * (size_t)nn);
    memset(q->moment, 0, sizeof(double) * 3 * (size_t)nn);
    static const int64_t ROW[4] = {0, 0, 1, 1}, COLUMN[4] = {0, 1, 1, 0};
    for (int corner = 0; corner < 4; corner++)
        for (int c = 0; c < 6; c++) {
            double *R to = c < 3 ? q->force + c * nn : q->moment + (c - 3) * nn;
            const double *R from = q->element_force + (6 * corner + c) * ne;
            for (int64_t j = 0; j < ny; j++) {
                double *R row = to + (j + ROW[corner]) * (nx + 1) + COLUMN[corner];
                const double *R of = from + j * nx;
                for (int64_t i = 0; i < nx; i++)
                    row[i] -= of[i];
            }
        }
}

/* Weights of Catmull and Rom's interpolation at u in (0, 1) between the second and the third of four nodes. */
static void interpolation(double u, double *R weight) {
    weight[0] = 0.5 * u * (-1.0 + u * (2.0 - u));
    weight[1] = 1.0 + 0.5 * u * u * (3.0 * u - 5.0);
    weight[2] = 0.5 * u * (1.0 + u * (4.0 - 3.0 * u));
    weight[3] = 0.5 * u * u * (u - 1.0);
}

static int64_t clamped(int64_t k, int64_t last) { return k < 0 ? 0 : k > last ? last : k; }

/* Contact of one tool, centre c (3) m moving with speed (3) m/s, with the smooth surface through the nodes; adds the
 * forces on the nodes and returns that on the tool in `on_tool`. */
static void touch(const Shell *R q, Tool *R tool, const double *R c, const double *R speed, double *R on_tool) {
    const int64_t nx = q->nx, ny = q->ny, nn = (nx + 1) * (ny + 1);
    const double *R x = q->position, *R y = x + nn, *R z = y + nn, *R v = q->velocity;
    double *R f = q->force;
    /* the nearest node, from the one found last */
    int64_t i = tool->node[0], j = tool->node[1];
    for (int moved = 1; moved;) {
        double best = 1e300;
        int64_t bi = i, bj = j;
        for (int64_t dj = -1; dj <= 1; dj++)
            for (int64_t di = -1; di <= 1; di++) {
                const int64_t ni = clamped(i + di, nx), nj = clamped(j + dj, ny), n = nj * (nx + 1) + ni;
                const double dx = x[n] - c[0], dy = y[n] - c[1], dz = z[n] - c[2], d = dx * dx + dy * dy + dz * dz;
                if (d < best)
                    best = d, bi = ni, bj = nj;
            }
        moved = bi != i || bj != j;
        i = bi, j = bj;
    }
    tool->node[0] = i, tool->node[1] = j, tool->touching = 0;
    static double table[POINTS][4];
    static int ready = 0;
    if (!ready) {
        for (int k = 0; k < POINTS; k++)
            interpolation((k + 0.5) / POINTS, table[k]);
        ready = 1;
    }
    on_tool[0] = on_tool[1] = on_tool[2] = 0.0;
    const double reach = tool->radius + tool->flat;
    /* half the window: as many elements as the tool may touch around the nearest node */
    const int64_t middle = clamped(j, ny - 1) * nx + clamped(i, nx - 1);
    const int64_t window = 2 + (int64_t)(reach / sqrt(q->area[middle]));
    for (int64_t ej = clamped(j - window, ny - 1); ej <= clamped(j + window - 1, ny - 1); ej++)
        for (int64_t ei = clamped(i - window, nx - 1); ei <= clamped(i + window - 1, nx - 1); ei++) {
            const int64_t e = ej * nx + ei, n1 = ej * (nx + 1) + ei, n3 = n1 + nx + 2;
            const double half = 0.5 * q->thickness[e], touch_at = tool->radius + half;
            const double mx = 0.5 * (x[n1] + x[n3]) - c[0], my = 0.5 * (y[n1] + y[n3]) - c[1];
            const double mz = 0.5 * (z[n1] + z[n3]) - c[2];
            const double ax = x[n3] - x[n1], ay = y[n3] - y[n1], az = z[n3] - z[n1];
            const double far = touch_at + tool->flat + 0.75 * sqrt(ax * ax + ay * ay + az * az);
            if (mx * mx + my * my + mz * mz > far * far)
                continue;
            double patch[3][16], push[3][16];
            int64_t node[16];
            for (int k = 0; k < 16; k++) {
                const int64_t n = clamped(ej - 1 + k / 4, ny) * (nx + 1) + clamped(ei - 1 + k % 4, nx);
                node[k] = n;
                patch[0][k] = x[n] - c[0], patch[1][k] = y[n] - c[1], patch[2][k] = z[n] - c[2];
            }
            memset(push, 0, sizeof push);
            int hit = 0;
            const double per_point = q->contact * q->area[e] / (POINTS * POINTS);
            for (int b = 0; b < POINTS; b++) {
                double line[3][4];
                for (int d = 0; d < 3; d++)
                    for (int k = 0; k < 4; k++)
                        line[d][k] = table[b][0] * patch[d][k] + table[b][1] * patch[d][4 + k] +
                            table[b][2] * patch[d][8 + k] + table[b][3] * patch[d][12 + k];
                for (int a = 0; a < POINTS; a++) {
                    const double *R t = table[a];
                    double at[3];
                    for (int d = 0; d < 3; d++)
                        at[d] = t[0] * line[d][0] + t[1] * line[d][1] + t[2] * line[d][2] + t[3] * line[d][3];
                    /* from the nearest point of the disc: a ball has none but its centre */
                    if (tool->flat > 0.0) {
                        const double out = sqrt(at[0] * at[0] + at[1] * at[1]) + 1e-12;
                        const double kept = out > tool->flat ? 1.0 - tool->flat / out : 0.0;
                        at[0] *= kept, at[1] *= kept;
                    }
                    const double square = at[0] * at[0] + at[1] * at[1] + at[2] * at[2];
                    if (square >= touch_at * touch_at)
                        continue;
                    const double distance = sqrt(square) + 1e-12;
                    double n[3] = {at[0] / distance, at[1] / distance, at[2] / distance}, slip[3], along = 0.0;
                    for (int d = 0; d < 3; d++) {
                        double fast = 0.0;
                        for (int m = 0; m < 16; m++)
                            fast += table[b][m / 4] * t[m % 4] * v[d * nn + node[m]];
                        slip[d] = fast - speed[d];
                        along += slip[d] * n[d];
                    }
                    double normal = per_point * (touch_at - distance - q->contact_time * along), size = 0.0;
                    normal = normal > 0.0 ? normal : 0.0;
                    for (int d = 0; d < 3; d++)
                        slip[d] -= along * n[d], size += slip[d] * slip[d];
                    const double rub = q->friction * normal / (sqrt(size) + q->slip_speed);
                    for (int d = 0; d < 3; d++) {
                        const double force = normal * n[d] - rub * slip[d];
                        on_tool[d] -= force;
                        for (int m = 0; m < 16; m++)
                            push[d][m] += table[b][m / 4] * t[m % 4] * force;
                    }
                    hit = 1;
                    tool->touching++;
                }
            }
            if (hit)
                for (int d = 0; d < 3; d++)
                    for (int k = 0; k < 16; k++)
                        f[d * nn + node[k]] += push[d][k];
        }
}

/* Steps after which it is found out anew which points are near the support, and what is near, m. */
enum { LOOK = 256 };
static const double NEAR = 1.5e-3;

/* m by which the lower face of the sheet is inside the rigid surface raised by `offset`, at point k, normal (3);
 * far outside where there is none. */
static double inside(const Shell *R q, int64_t k, const int64_t *R node, const double *R weight, double offset,
                     double *R n) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1), sx = q->support_nx, sy = q->support_ny;
    double at[3];
    for (int d = 0; d < 3; d++) {
        at[d] = 0.0;
        for (int m = 0; m < 4; m++)
            at[d] += weight[m] * q->position[d * nn + node[m]];
    }
    const double gx = (at[0] - q->support_x) / q->support_spacing, gy = (at[1] - q->support_y) / q->support_spacing;
    if (!(gx >= 0.0 && gy >= 0.0 && gx < (double)(sx - 1) && gy < (double)(sy - 1)))
        return -1.0;
    const int64_t ci = (int64_t)gx, cj = (int64_t)gy;
    const double *R h = q->support_height + cj * sx + ci;
    const double u = gx - (double)ci, w = gy - (double)cj;
    const double low = h[0] + u * (h[1] - h[0]), high = h[sx] + u * (h[sx + 1] - h[sx]);
    const double height = low + w * (high - low) + offset;
    if (!(height > -1e3)) /* none at a corner */
        return -1.0;
    const double slope_x = ((1.0 - w) * (h[1] - h[0]) + w * (h[sx + 1] - h[sx])) / q->support_spacing;
    const double slope_y = (high - low) / q->support_spacing;
    const double up = 1.0 / sqrt(1.0 + slope_x * slope_x + slope_y * slope_y);
    n[0] = -slope_x * up, n[1] = -slope_y * up, n[2] = up;
    return (height - at[2]) * up + 0.5 * q->thickness[q->support_element[k]];
}

static void corners_of(const Shell *R q, int64_t k, int64_t *R node, double *R weight) {
    const int64_t nx = q->nx, e = q->support_element[k], n1 = (e / nx) * (nx + 1) + e % nx;
    node[0] = n1, node[1] = n1 + 1, node[2] = n1 + nx + 2, node[3] = n1 + nx + 1;
    for (int m = 0; m < 4; m++)
        weight[m] = q->support_weight[m * q->support_size + k];
}

/* The points that may touch the rigid surface before it is found out anew; returns how many. */
static int64_t near_support(const Shell *R q, double offset) {
    int64_t count = 0, node[4];
    double weight[4], n[3];
    for (int64_t k = 0; k < q->support_size; k++) {
        corners_of(q, k, node, weight);
        if (inside(q, k, node, weight, offset, n) > -NEAR)
            q->support_near[count++] = (int32_t)k;
    }
    return count;
}

/* The rigid surface under the sheet pushes where the lower face is below it. */
static void support(const Shell *R q, int64_t count, double offset) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1);
    const double *R v = q->velocity;
    double *R f = q->force;
    for (int64_t near = 0; near < count; near++) {
        const int64_t k = q->support_near[near];
        int64_t node[4];
        double weight[4], n[3], slip[3], along = 0.0, size = 0.0;
        corners_of(q, k, node, weight);
        const double deep = inside(q, k, node, weight, offset, n);
        if (deep <= 0.0)
            continue;
        const double normal = q->contact * q->support_area[k] * deep;
        for (int d = 0; d < 3; d++) {
            slip[d] = 0.0;
            for (int m = 0; m < 4; m++)
                slip[d] += weight[m] * v[d * nn + node[m]];
            along += slip[d] * n[d];
        }
        for (int d = 0; d < 3; d++)
            slip[d] -= along * n[d], size += slip[d] * slip[d];
        const double rub = q->friction * normal / (sqrt(size) + q->slip_speed);
        for (int d = 0; d < 3; d++)
            for (int m = 0; m < 4; m++)
                f[d * nn + node[m]] += weight[m] * (normal * n[d] - rub * slip[d]);
    }
}

/* Springs of the clamped edge in the plane; beyond its limit of friction an anchor slides after its node. */
static void edges(const Shell *R q) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1);
    for (int64_t n = 0; n < nn; n++) {
        if (q->spring[n] <= 0.0)
            continue;
        double dx = q->position[n] - q->anchor[n], dy = q->position[nn + n] - q->anchor[nn + n];
        const double size = sqrt(dx * dx + dy * dy), limit = q->spring_limit[n] / q->spring[n];
        if (size > limit) {
            const double kept = limit / size;
            dx *= kept, dy *= kept;
            q->anchor[n] = q->position[n] - dx, q->anchor[nn + n] = q->position[nn + n] - dy;
        }
        q->force[n] -= q->spring[n] * dx, q->force[nn + n] -= q->spring[n] * dy;
    }
}

VECTORISED static void move(const Shell *R q) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1);
    const double dt = q->step, kept = 1.0 - q->damping * dt;
    const uint8_t *R fixed = q->fixed;
    const double *R mass = q->mass, *R inertia = q->inertia;
    for (int d = 0; d < 3; d++) {
        double *R x = q->position + d * nn, *R v = q->velocity + d * nn, *R w = q->spin + d * nn;
        const double *R f = q->force + d * nn, *R m = q->moment + d * nn;
        const uint8_t bit = (uint8_t)(1 << d);
        for (int64_t n = 0; n < nn; n++) {
            v[n] = fixed[n] & bit ? 0.0 : kept * v[n] + dt * f[n] / mass[n];
            w[n] = fixed[n] & 8 ? 0.0 : kept * w[n] + dt * m[n] / inertia[n];
            x[n] += dt * v[n];
        }
    }
}

/* `steps` steps, while the tools go from begin to end; a tool of radius 0 is not there. */
void isf_shell_advance(const Shell *q, Tool *tools, int64_t steps, double smoothing) {
    for (int t = 0; t < TOOLS; t++)
        memset(tools[t].mean, 0, sizeof tools[t].mean);
    int64_t near = 0;
    for (int64_t k = 1; k <= steps; k++) {
        const double offset = q->support_from + (q->support_to - q->support_from) * ((double)k / (double)steps);
        if (k % LOOK == 1)
            near = near_support(q, offset);
        elements(q, 0, q->ny);
        assemble(q);
        for (int t = 0; t < TOOLS; t++) {
            Tool *tool = tools + t;
            if (tool->radius <= 0.0)
                continue;
            double centre[3], speed[3], felt[3];
            for (int d = 0; d < 3; d++) {
                speed[d] = (tool->end[d] - tool->begin[d]) / ((double)steps * q->step);
                centre[d] = tool->begin[d] + (tool->end[d] - tool->begin[d]) * ((double)k / (double)steps) +
                    tool->compliance[d] * tool->felt[d];
            }
            touch(q, tool, centre, speed, felt);
            for (int d = 0; d < 3; d++) {
                tool->felt[d] += smoothing * (felt[d] - tool->felt[d]);
                tool->mean[d] += felt[d] / (double)steps;
            }
        }
        support(q, near, offset);
        edges(q);
        move(q);
    }
}

/* An empty module, so that Python finds and loads the library as it does any other; see library.py. */
PyMODINIT_FUNC PyInit__shell(void) {
    static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_shell", NULL, -1, NULL, NULL, NULL, NULL, NULL};
    return PyModule_Create(&module);
}
