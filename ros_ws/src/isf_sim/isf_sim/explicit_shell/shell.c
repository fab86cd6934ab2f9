/* Explicit dynamics of a thin elasto-plastic sheet between moving tools, on a structured grid of quadrilaterals.
 *
 * Element: four nodes, one point in the plane, five through the thickness; corotational velocity strains, Mindlin shear
 * and hourglass stiffness after Belytschko 1984, with the curvature that a warped element gets from its membrane
 * velocities (Belytschko 1992). Material: J2 plasticity in plane stress, hardening by a table, isotropic or a share of
 * it kinematic after Prager, return mapping in the eigenvectors of the projection (Simo 1986). Central differences,
 * lumped mass.
 *
 * Arrays are (components, entries), entries fastest; node n = j (nx + 1) + i, element e = j nx + i. SI units.
 * Corners 1 to 4 of element (i, j): (i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1). The layout and the order of the
 * fields of the structs are repeated in library.py.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define VECTORISED __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define VECTORISED
#endif
#define R restrict

enum { LAYERS = 5, POINTS = 8, TOOLS = 2 };

/* Of the shear stiffness in the plane, for a node that turns about the normal against the element. Without any, the
 * elements of a curved sheet, whose normals differ, twist against each other at no cost. */
static const double DRILLING = 1e-3;

/* Gauss-Legendre points and weights on (-1, 1) */
static const double LEVEL[LAYERS] = {-0.906179845938664, -0.538469310105683, 0.0, 0.538469310105683, 0.906179845938664};
static const double SHARE[LAYERS] = {0.236926885056189, 0.478628670499366, 0.568888888888889, 0.478628670499366,
                                     0.236926885056189};

typedef struct {
    int64_t nx, ny, table_size, support_size, spring_size;
    /* contact: N/m^3, pressure per depth; contact_time: s, depth that a speed of approach counts as, over that speed;
     * drag: N s/m^3, friction over the speed of slip, at most */
    double young, poisson, step, damping, table_step, contact, contact_time, friction, slip_speed, drag;
    double kinematic;                                    /* share of the hardening that moves the yield surface */
    double *position, *velocity, *spin, *force, *moment; /* (3, nodes) */
    const double *per_mass, *per_inertia;                /* (nodes) 1/kg, 1/(kg m^2) */
    const int32_t *spring_node;                          /* (spring_size) nodes of the edge that a spring holds */
    const double *spring, *spring_limit;                 /* (spring_size) N/m and N, in the plane */
    double *anchor;                                      /* (2, nodes) where these springs are free of force */
    const uint8_t *fixed;                                /* (nodes) bits 1, 2, 4: x, y, z; 8, 16, 32: turns about them;
                                                          * these keep the velocity they have, which is mostly none */
    const double *load;                                  /* (3, nodes) N that do not change, or NULL */
    double *thickness, *stress, *plastic_strain;         /* (elements), (LAYERS 3, elements), (LAYERS, elements) */
    double *shear, *hourglass, *plastic_work;            /* (2, elements), (5, elements), (elements) J */
    double *drilling;                                    /* (4, elements) N m about the normal, on the corners */
    double *back_stress;                                 /* (LAYERS 3, elements) Pa, only where kinematic is not 0 */
    double *element_force;                               /* (24, elements), scratch */
    double *contact_force;                               /* (TOOLS + 1, 3, nodes), scratch, zero: tools, support */
    uint8_t *in_contact;                                 /* (TOOLS + 1, ny + 1), scratch, zero: rows of nodes with any */
    double *thickness_before;                            /* (elements), scratch: what contact sees while it changes */
    const double *flow_stress, *hardening;               /* (table_size) Pa, isotropic part, over the plastic strain */
    const double *area;                                  /* (elements) m^2, undeformed */
    /* a rigid surface under the sheet: heights (support_ny, support_nx) m on a regular grid, -1e9: none */
    int64_t support_nx, support_ny;
    double support_x, support_y, support_spacing;
    double support_from, support_to; /* m by which it stands higher before and after the steps */
    const double *support_height;
    const double *support_plane;                         /* (elements) height m where it is a plane, -1e9: elsewhere */
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

/* Elements side by side that one call of `block` computes: two vectors of the widest registers. */
enum { BLOCK = 16 };

/* `count` elements from number `begin` of row j on. What the layers need of the kinematics, and the forces need of
 * both, stands in arrays of a block, so that each of the three loops is made of vector code and the return mapping is
 * left out where no element of the block yields, as most do not. */
static inline __attribute__((always_inline)) void block(const Shell *R q, int64_t j, int64_t begin, const int64_t count,
                                                        const int mixed) {
    const int64_t nx = q->nx, nn = (q->nx + 1) * (q->ny + 1), ne = q->nx * q->ny, last = q->table_size - 2;
    const double young = q->young, nu = q->poisson, dt = q->step;
    const double G = young / (2.0 * (1.0 + nu)), C = young / (1.0 - nu * nu), kappa = 5.0 / 6.0;
    const double bulk = young / (3.0 * (1.0 - nu)), thin = -nu / (1.0 - nu), per_step = 1.0 / q->table_step;
    const double moving = mixed ? q->kinematic / (1.0 - q->kinematic) : 0.0; /* kinematic over isotropic hardening */
    const int64_t first = j * (nx + 1) + begin, element = j * nx + begin;
    const double *R px = q->position + first, *R py = px + nn, *R pz = py + nn;
    const double *R qx = q->velocity + first, *R qy = qx + nn, *R qz = qy + nn;
    const double *R rx = q->spin + first, *R ry = rx + nn, *R rz = ry + nn;
    const double *R flow = q->flow_stress, *R hard = q->hardening;
    double *R thickness = q->thickness + element, *R work = q->plastic_work + element;
    double *R shear = q->shear + element, *R hg = q->hourglass + element, *R out = q->element_force + element;
    double *R drill = q->drilling + element;
    /* frame; derivatives of the shape functions times the area; warping; strain rates; velocities for the hourglass */
    double ux[BLOCK], uy[BLOCK], uz[BLOCK], vx[BLOCK], vy[BLOCK], vz[BLOCK], wx[BLOCK], wy[BLOCK], wz[BLOCK];
    double b11[BLOCK], b12[BLOCK], b21[BLOCK], b22[BLOCK], A[BLOCK], iA[BLOCK], g1[BLOCK], g2[BLOCK], warp[BLOCK];
    double pxx[BLOCK], pyy[BLOCK], pxy[BLOCK], px1[BLOCK], py1[BLOCK], px2[BLOCK], py2[BLOCK];
    double ex[BLOCK], ey[BLOCK], exy[BLOCK], kx[BLOCK], ky[BLOCK], kxy[BLOCK];
    double hg1[BLOCK], hg2[BLOCK], hg3[BLOCK], hg4[BLOCK], hg5[BLOCK], Qx[BLOCK], Qy[BLOCK];
    double Nx[BLOCK], Ny[BLOCK], Nxy[BLOCK], Mx[BLOCK], My[BLOCK], Mxy[BLOCK], ezz[BLOCK], done[BLOCK];
#pragma omp simd
    for (int64_t i = 0; i < count; i++) {
        const int64_t n1 = i, n2 = i + 1, n4 = i + nx + 1, n3 = n4 + 1;
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
        const double Ux = sx + tx, Uy = sy + ty, Uz = sz + tz, Vx = sx - tx, Vy = sy - ty, Vz = sz - tz;
        const double Wx = Uy * Vz - Uz * Vy, Wy = Uz * Vx - Ux * Vz, Wz = Ux * Vy - Uy * Vx;
        /* derivatives of the shape functions in the middle, times the area */
        const double x31 = DOT(a, U), y31 = DOT(a, V), x42 = DOT(b, U), y42 = DOT(b, V);
        const double area_now = 0.5 * (x31 * y42 - x42 * y31), inverse = 1.0 / area_now;
        const double c11 = -0.5 * y42, c12 = 0.5 * y31, c21 = 0.5 * x42, c22 = -0.5 * x31;
        /* corners seen from corner 1, for hourglass shape and warping */
        const double cx = px[n2] - px[n1], cy = py[n2] - py[n1], cz = pz[n2] - pz[n1];
        const double dx = px[n4] - px[n1], dy = py[n4] - py[n1], dz = pz[n4] - pz[n1];
        const double x21 = DOT(c, U), y21 = DOT(c, V), z21 = DOT(c, W);
        const double x41 = DOT(d, U), y41 = DOT(d, V), z41 = DOT(d, W), z31 = DOT(a, W);
        const double lx = x31 - x21 - x41, ly = y31 - y21 - y41;
        const double shape_1 = 1.0 - inverse * (lx * c11 + ly * c21), shape_2 = -1.0 - inverse * (lx * c12 + ly * c22);
        /* warping: z = c xi eta; gradient of the normals' in-plane components, minus the second derivatives of z */
        const double twist = 0.25 * (z31 - z21 - z41);
        const double xi_x = inverse * (y31 + y42), xi_y = -inverse * (x31 + x42);
        const double eta_x = inverse * (y42 - y31), eta_y = inverse * (x31 - x42);
        const double nxx = -2.0 * twist * xi_x * eta_x, nyy = -2.0 * twist * xi_y * eta_y;
        const double nxy = -twist * (xi_x * eta_y + xi_y * eta_x);
        /* normals in corners 1 and 2; those of 3 and 4 lean the other way */
        const double nx1 = twist * (xi_x + eta_x), ny1 = twist * (xi_y + eta_y);
        const double nx2 = twist * (xi_x - eta_x), ny2 = twist * (xi_y - eta_y);
        /* velocities in the frame; B is antisymmetric in opposite corners, so two differences are enough */
        double mx = qx[n1] - qx[n3], my = qy[n1] - qy[n3], mz = qz[n1] - qz[n3];
        const double u13 = DOT(m, U), v13 = DOT(m, V), w13 = DOT(m, W);
        mx = qx[n2] - qx[n4], my = qy[n2] - qy[n4], mz = qz[n2] - qz[n4];
        const double u24 = DOT(m, U), v24 = DOT(m, V), w24 = DOT(m, W);
        mx = qx[n1] + qx[n3] - qx[n2] - qx[n4], my = qy[n1] + qy[n3] - qy[n2] - qy[n4];
        mz = qz[n1] + qz[n3] - qz[n2] - qz[n4];
        const double us = DOT(m, U), vs = DOT(m, V), ws = DOT(m, W);
        /* velocity gradients */
        const double uxx = (c11 * u13 + c12 * u24) * inverse, uxy = (c21 * u13 + c22 * u24) * inverse;
        const double vxx = (c11 * v13 + c12 * v24) * inverse, vxy = (c21 * v13 + c22 * v24) * inverse;
        /* spins; about the normal of its corner each node turns with the element, but for the drilling stiffness */
        const double turn = 0.5 * (vxx - uxy);
        mx = rx[n1] - rx[n3], my = ry[n1] - ry[n3], mz = rz[n1] - rz[n3];
        double ox = rx[n1] + rx[n3], oy = ry[n1] + ry[n3], oz = rz[n1] + rz[n3];
        double about = DOT(o, W) - 2.0 * turn;
        const double p13 = DOT(m, U) - nx1 * about, q13 = DOT(m, V) - ny1 * about;
        const double against = 0.125 * DRILLING * G * thickness[i] * area_now * dt;
        double of_both = against * about;
        about = DOT(m, W);
        drill[i] += of_both + against * about, drill[2 * ne + i] += of_both - against * about;
        const double ps13 = DOT(o, U) - nx1 * about, qs13 = DOT(o, V) - ny1 * about;
        mx = rx[n2] - rx[n4], my = ry[n2] - ry[n4], mz = rz[n2] - rz[n4];
        ox = rx[n2] + rx[n4], oy = ry[n2] + ry[n4], oz = rz[n2] + rz[n4];
        about = DOT(o, W) - 2.0 * turn;
        const double p24 = DOT(m, U) - nx2 * about, q24 = DOT(m, V) - ny2 * about;
        of_both = against * about;
        about = DOT(m, W);
        drill[ne + i] += of_both + against * about, drill[3 * ne + i] += of_both - against * about;
        const double ps24 = DOT(o, U) - nx2 * about, qs24 = DOT(o, V) - ny2 * about;
        const double pm = 0.25 * (ps13 + ps24), qm = 0.25 * (qs13 + qs24), ps = ps13 - ps24, qs = qs13 - qs24;
        /* curvatures and shear */
        const double xy = uxy + vxx;
        const double slope_x = (c11 * w13 + c12 * w24) * inverse, slope_y = (c21 * w13 + c22 * w24) * inverse;
        ex[i] = uxx * dt, ey[i] = vxy * dt, exy[i] = xy * dt;
        kx[i] = dt * ((c11 * q13 + c12 * q24) * inverse - uxx * nxx - 0.5 * xy * nxy);
        ky[i] = dt * (-(c21 * p13 + c22 * p24) * inverse - vxy * nyy - 0.5 * xy * nxy);
        kxy[i] = dt * ((c21 * q13 + c22 * q24 - c11 * p13 - c12 * p24) * inverse - (uxx + vxy) * nxy
                       - 0.5 * xy * (nxx + nyy));
        Qx[i] = shear[i] += G * (slope_x + qm) * dt, Qy[i] = shear[ne + i] += G * (slope_y - pm) * dt;
        /* hourglass velocities, gamma . v with g1 + g3 = 2, g2 + g4 = -2; a warped element that turns has membrane
         * velocities of its own */
        const double m1 = shape_1 - 1.0, m2 = shape_2 + 1.0;
        hg1[i] = ps + m1 * p13 + m2 * p24, hg2[i] = qs + m1 * q13 + m2 * q24, hg3[i] = ws + m1 * w13 + m2 * w24;
        hg4[i] = us + m1 * u13 + m2 * u24 + 4.0 * twist * slope_x, hg5[i] = vs + m1 * v13 + m2 * v24 + 4.0 * twist * slope_y;
        ux[i] = Ux, uy[i] = Uy, uz[i] = Uz, vx[i] = Vx, vy[i] = Vy, vz[i] = Vz, wx[i] = Wx, wy[i] = Wy, wz[i] = Wz;
        b11[i] = c11, b12[i] = c12, b21[i] = c21, b22[i] = c22, A[i] = area_now, iA[i] = inverse;
        g1[i] = shape_1, g2[i] = shape_2, warp[i] = twist;
        pxx[i] = nxx, pyy[i] = nyy, pxy[i] = nxy, px1[i] = nx1, py1[i] = ny1, px2[i] = nx2, py2[i] = ny2;
        Nx[i] = Ny[i] = Nxy[i] = Mx[i] = My[i] = Mxy[i] = ezz[i] = done[i] = 0.0;
    }
    for (int k = 0; k < LAYERS; k++) {
        double *R s = q->stress + 3 * k * ne + element, *R ep = q->plastic_strain + k * ne + element;
        double *R back = mixed ? q->back_stress + 3 * k * ne + element : s;
        double sum[BLOCK], dif[BLOCK], txy[BLOCK], Y[BLOCK], H[BLOCK], strain_sum[BLOCK];
        int64_t yielding = 0;
#pragma omp simd reduction(| : yielding)
        for (int64_t i = 0; i < count; i++) {
            const double z = 0.5 * thickness[i] * LEVEL[k];
            const double dex = ex[i] + z * kx[i], dey = ey[i] + z * ky[i];
            double trial_x = s[i] + C * (dex + nu * dey), trial_y = s[ne + i] + C * (dey + nu * dex);
            txy[i] = s[2 * ne + i] + G * (exy[i] + z * kxy[i]);
            if (mixed)
                trial_x -= back[i], trial_y -= back[ne + i], txy[i] -= back[2 * ne + i];
            sum[i] = trial_x + trial_y, dif[i] = trial_x - trial_y, strain_sum[i] = dex + dey;
            int32_t place = (int32_t)(ep[i] * per_step);
            place = place < last ? place : (int32_t)last;
            place = place > 0 ? place : 0; /* also where a sheet that has become unstable gives no number */
            H[i] = hard[place], Y[i] = flow[place] + H[i] * (ep[i] - place * q->table_step);
            const double P = sum[i] * sum[i] * (1.0 / 6.0), Q = 0.5 * dif[i] * dif[i] + 2.0 * txy[i] * txy[i];
            yielding |= 0.5 * (P + Q) > Y[i] * Y[i] * (1.0 / 3.0) ? 1 : 0;
        }
        double plastic[BLOCK] = {0.0};
        if (yielding) {
#pragma omp simd
            for (int64_t i = 0; i < count; i++) {
                const double P = sum[i] * sum[i] * (1.0 / 6.0), Q = 0.5 * dif[i] * dif[i] + 2.0 * txy[i] * txy[i];
                const double on = 0.5 * (P + Q) > Y[i] * Y[i] * (1.0 / 3.0) ? 1.0 : 0.0;
                const double prager = 2.0 / 3.0 * moving * H[i], of_sum = bulk + prager, of_dif = 2.0 * G + prager;
                double dg = 0.0, d1, d2, square, length;
#pragma GCC unroll 3
                for (int it = 0; it < 3; it++) {
                    d1 = 1.0 / (1.0 + of_sum * dg), d2 = 1.0 / (1.0 + of_dif * dg);
                    square = P * d1 * d1 + Q * d2 * d2;
                    length = sqrt(2.0 / 3.0 * square) + 1e-30;
                    const double Yk = Y[i] + H[i] * dg * length;
                    const double slope = -2.0 * (of_sum * P * d1 * d1 * d1 + of_dif * Q * d2 * d2 * d2);
                    const double f = 0.5 * square - Yk * Yk * (1.0 / 3.0);
                    const double df = 0.5 * slope - 2.0 / 3.0 * Yk * H[i] * (length + dg * slope / (3.0 * length));
                    dg -= on * f / df;
                    dg = dg > 0.0 ? dg : 0.0;
                }
                d1 = 1.0 / (1.0 + of_sum * dg), d2 = 1.0 / (1.0 + of_dif * dg);
                square = P * d1 * d1 + Q * d2 * d2;
                const double more = dg * sqrt(2.0 / 3.0 * square);
                sum[i] *= d1, dif[i] *= d2, txy[i] *= d2;
                plastic[i] = dg * sum[i] * (1.0 / 3.0);
                ep[i] += more;
                if (mixed) {
                    back[i] += 0.5 * prager * dg * (sum[i] + dif[i]), back[ne + i] += 0.5 * prager * dg * (sum[i] - dif[i]);
                    back[2 * ne + i] += prager * dg * txy[i];
                }
                done[i] += 0.5 * thickness[i] * SHARE[k] * more * (Y[i] + 0.5 * H[i] * more);
            }
        }
#pragma omp simd
        for (int64_t i = 0; i < count; i++) {
            const double half = 0.5 * thickness[i], z = half * LEVEL[k], weight = half * SHARE[k];
            double new_x = 0.5 * (sum[i] + dif[i]), new_y = 0.5 * (sum[i] - dif[i]);
            if (mixed)
                new_x += back[i], new_y += back[ne + i], txy[i] += back[2 * ne + i];
            s[i] = new_x, s[ne + i] = new_y, s[2 * ne + i] = txy[i];
            ezz[i] += 0.5 * SHARE[k] * (thin * (strain_sum[i] - plastic[i]) - plastic[i]);
            Nx[i] += weight * new_x, Ny[i] += weight * new_y, Nxy[i] += weight * txy[i];
            Mx[i] += weight * z * new_x, My[i] += weight * z * new_y, Mxy[i] += weight * z * txy[i];
        }
    }
#pragma omp simd
    for (int64_t i = 0; i < count; i++) {
        const double h = thickness[i];
        thickness[i] = h * (1.0 + ezz[i]);
        work[i] += done[i] * A[i];
        /* membrane forces with the part of the moments that a warped element turns into them */
        const double Txx = Nx[i] - Mx[i] * pxx[i] - Mxy[i] * pxy[i], Tyy = Ny[i] - My[i] * pyy[i] - Mxy[i] * pxy[i];
        const double Txy = Nxy[i] - 0.5 * ((Mx[i] + My[i]) * pxy[i] + Mxy[i] * (pxx[i] + pyy[i]));
        const double of_x = kappa * h * Qx[i], of_y = kappa * h * Qy[i];
        /* hourglass stiffness: bending, shear, membrane */
        const double squares = b11[i] * b11[i] + b12[i] * b12[i] + b21[i] * b21[i] + b22[i] * b22[i];
        const double BB = 2.0 * squares * iA[i] * iA[i] * dt;
        const double of_bending = 0.03 / 192.0 * young * h * h * h * A[i] * BB;
        const double of_shear = 0.03 / 12.0 * kappa * G * h * h * h * BB, of_membrane = 0.03 / 8.0 * young * h * A[i] * BB;
        const double H1 = hg[i] += of_bending * hg1[i], H2 = hg[ne + i] += of_bending * hg2[i];
        const double H3 = hg[2 * ne + i] += of_shear * hg3[i];
        const double H4 = hg[3 * ne + i] += of_membrane * hg4[i], H5 = hg[4 * ne + i] += of_membrane * hg5[i];
        const double across_x = of_x + 4.0 * warp[i] * iA[i] * H4, across_y = of_y + 4.0 * warp[i] * iA[i] * H5;
        const double g3 = 2.0 - g1[i], g4 = -2.0 - g2[i];
#define MOMENTS(I, B1, B2, GAMMA)                                                                                      \
    const double s##I = -(B2)*My[i] - (B1)*Mxy[i] - 0.25 * A[i] * of_y + (GAMMA)*H1;                                   \
    const double t##I = (B1)*Mx[i] + (B2)*Mxy[i] + 0.25 * A[i] * of_x + (GAMMA)*H2;
        MOMENTS(0, b11[i], b21[i], g1[i])
        MOMENTS(1, b12[i], b22[i], g2[i])
        MOMENTS(2, -b11[i], -b21[i], g3)
        MOMENTS(3, -b12[i], -b22[i], g4)
        const double D0 = drill[i], D1 = drill[ne + i], D2 = drill[2 * ne + i], D3 = drill[3 * ne + i];
        const double S = 0.5 * iA[i] * (px1[i] * (s0 - s2) + py1[i] * (t0 - t2) + px2[i] * (s1 - s3) + py2[i] * (t1 - t3)
                                        - D0 - D1 - D2 - D3);
#define CORNER(I, B1, B2, GAMMA, PX, PY)                                                                               \
    {                                                                                                                  \
        const double f1 = (B1)*Txx + (B2) * (Txy - S) + (GAMMA)*H4, f2 = (B1) * (Txy + S) + (B2)*Tyy + (GAMMA)*H5;     \
        const double f3 = (B1)*across_x + (B2)*across_y + (GAMMA)*H3, r = D##I - (PX)*s##I - (PY)*t##I;                      \
        double *R o = out + 6 * (I)*ne;                                                                                \
        o[i] = f1 * ux[i] + f2 * vx[i] + f3 * wx[i], o[ne + i] = f1 * uy[i] + f2 * vy[i] + f3 * wy[i];                 \
        o[2 * ne + i] = f1 * uz[i] + f2 * vz[i] + f3 * wz[i];                                                          \
        o[3 * ne + i] = s##I * ux[i] + t##I * vx[i] + r * wx[i];                                                       \
        o[4 * ne + i] = s##I * uy[i] + t##I * vy[i] + r * wy[i];                                                       \
        o[5 * ne + i] = s##I * uz[i] + t##I * vz[i] + r * wz[i];                                                       \
    }
        CORNER(0, b11[i], b21[i], g1[i], px1[i], py1[i])
        CORNER(1, b12[i], b22[i], g2[i], px2[i], py2[i])
        CORNER(2, -b11[i], -b21[i], g3, -px1[i], -py1[i])
        CORNER(3, -b12[i], -b22[i], g4, -px2[i], -py2[i])
    }
}

/* Forces of the elements of rows `from` to `to` - 1. */
VECTORISED static void elements(const Shell *R q, int64_t from, int64_t to) {
    const int64_t whole = q->nx / BLOCK * BLOCK, rest = q->nx - whole;
    const int mixed = q->kinematic > 0.0;
    for (int64_t j = from; j < to; j++) {
        for (int64_t i = 0; i < whole; i += BLOCK) {
            if (mixed)
                block(q, j, i, BLOCK, 1);
            else
                block(q, j, i, BLOCK, 0);
        }
        if (rest)
            block(q, j, whole, rest, mixed);
    }
}

/* N s/m, Coulomb's friction over the speed of slip, which fades below slip_speed, and no more than the time step bears on
 * the area, m^2; square: of the speed, m^2/s^2. */
static inline __attribute__((always_inline)) double friction(const Shell *R q, double normal, double square,
                                                             double area) {
    const double rub = q->friction * normal / (sqrt(square) + q->slip_speed), most = q->drag * area;
    return rub < most ? rub : most;
}

/* A plane under the sheet pushes each element of rows `from` to `to` - 1 whose lower face is below it, with a quarter on
 * each corner; the forces are added to those of the elements. */
VECTORISED static void planes(const Shell *R q, double offset, int64_t from, int64_t to) {
    const int64_t nx = q->nx, nn = (nx + 1) * (q->ny + 1), ne = nx * q->ny;
    for (int64_t j = from; j < to; j++) {
        const double *R z = q->position + 2 * nn + j * (nx + 1), *R above = z + nx + 1;
        const double *R vx = q->velocity + j * (nx + 1), *R vy = vx + nn;
        const double *R plane = q->support_plane + j * nx, *R area = q->area + j * nx, *R thickness = q->thickness + j * nx;
        double *R out = q->element_force + j * nx;
#pragma omp simd
        for (int64_t i = 0; i < nx; i++) {
            const double height = 0.25 * (z[i] + z[i + 1] + above[i] + above[i + 1]);
            const double deep = plane[i] + offset - height + 0.5 * thickness[i];
            const double quarter = 0.25 * q->contact * area[i] * (deep > 0.0 ? deep : 0.0);
            const double sx = 0.25 * (vx[i] + vx[i + 1] + vx[i + nx + 1] + vx[i + nx + 2]);
            const double sy = 0.25 * (vy[i] + vy[i + 1] + vy[i + nx + 1] + vy[i + nx + 2]);
            const double rub = friction(q, quarter, sx * sx + sy * sy, 0.25 * area[i]);
#pragma GCC unroll 4
            for (int corner = 0; corner < 4; corner++) {
                double *R o = out + 6 * corner * ne;
                o[i] += rub * sx, o[ne + i] += rub * sy, o[2 * ne + i] -= quarter;
            }
        }
    }
}

/* Loads, internal forces and contact on the nodes of rows `from` to `to` - 1, with their sign as they act on the nodes. */
VECTORISED static void assemble(const Shell *R q, int64_t from, int64_t to) {
    const int64_t nx = q->nx, ny = q->ny, nn = (nx + 1) * (ny + 1), ne = nx * ny;
    static const int64_t ROW[4] = {0, 0, 1, 1}, COLUMN[4] = {0, 1, 1, 0};
    for (int64_t j = from; j < to; j++)
        for (int c = 0; c < 6; c++) {
            double *R node = (c < 3 ? q->force + c * nn : q->moment + (c - 3) * nn) + j * (nx + 1);
            if (q->load && c < 3)
                memcpy(node, q->load + c * nn + j * (nx + 1), sizeof(double) * (size_t)(nx + 1));
            else
                memset(node, 0, sizeof(double) * (size_t)(nx + 1));
            for (int corner = 0; corner < 4; corner++) {
                const int64_t row = j - ROW[corner];
                if (row < 0 || row >= ny)
                    continue;
                double *R to_node = node + COLUMN[corner];
                const double *R of = q->element_force + (6 * corner + c) * ne + row * nx;
                for (int64_t i = 0; i < nx; i++)
                    to_node[i] -= of[i];
            }
            for (int k = 0; k < TOOLS + 1 && c < 3; k++)
                if (q->in_contact[k * (ny + 1) + j]) {
                    double *R push = q->contact_force + (3 * k + c) * nn + j * (nx + 1);
                    for (int64_t i = 0; i <= nx; i++)
                        node[i] += push[i], push[i] = 0.0;
                }
        }
    for (int k = 0; k < TOOLS + 1; k++)
        memset(q->in_contact + k * (ny + 1) + from, 0, (size_t)(to - from));
}

/* Weights of Catmull and Rom's interpolation at u in (0, 1) between the second and the third of four nodes. */
static void interpolation(double u, double *R weight) {
    weight[0] = 0.5 * u * (-1.0 + u * (2.0 - u));
    weight[1] = 1.0 + 0.5 * u * u * (3.0 * u - 5.0);
    weight[2] = 0.5 * u * (1.0 + u * (4.0 - 3.0 * u));
    weight[3] = 0.5 * u * u * (u - 1.0);
}

static int64_t clamped(int64_t k, int64_t last) { return k < 0 ? 0 : k > last ? last : k; }

/* Contact of tool `number`, centre c (3) m moving with speed (3) m/s, with the smooth surface through the nodes: forces on
 * the nodes in contact_force, that on the tool in `on_tool`, by which the latter falls per metre that the tool gives way in
 * `stiffness`, N/m (xx, yy, zz, xy, yz, zx). */
static void touch(const Shell *R q, Tool *R tool, int number, const double *R c, const double *R speed,
                  double *R on_tool, double *R stiffness) {
    const int64_t nx = q->nx, ny = q->ny, nn = (nx + 1) * (ny + 1);
    const double *R x = q->position, *R y = x + nn, *R z = y + nn, *R v = q->velocity;
    double *R f = q->contact_force + 3 * number * nn;
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
    double table[POINTS][4];
    for (int k = 0; k < POINTS; k++)
        interpolation((k + 0.5) / POINTS, table[k]);
    on_tool[0] = on_tool[1] = on_tool[2] = 0.0;
    memset(stiffness, 0, sizeof(double) * 6);
    const double reach = tool->radius + tool->flat;
    /* half the window: as many elements as the tool may touch around the nearest node */
    const int64_t middle = clamped(j, ny - 1) * nx + clamped(i, nx - 1);
    const int64_t window = 2 + (int64_t)(reach / sqrt(q->area[middle]));
    for (int64_t ej = clamped(j - window, ny - 1); ej <= clamped(j + window - 1, ny - 1); ej++)
        for (int64_t ei = clamped(i - window, nx - 1); ei <= clamped(i + window - 1, nx - 1); ei++) {
            const int64_t e = ej * nx + ei, n1 = ej * (nx + 1) + ei, n3 = n1 + nx + 2;
            const double half = 0.5 * q->thickness_before[e], touch_at = tool->radius + half;
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
            double normals[6] = {0.0};
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
                    const double rub = friction(q, normal, size, q->area[e] / (POINTS * POINTS));
                    for (int d = 0; d < 3; d++) {
                        const double force = normal * n[d] - rub * slip[d];
                        on_tool[d] -= force;
                        for (int m = 0; m < 16; m++)
                            push[d][m] += table[b][m / 4] * t[m % 4] * force;
                    }
                    for (int d = 0; d < 3 && normal > 0.0; d++)
                        normals[d] += n[d] * n[d], normals[3 + d] += n[d] * n[(d + 1) % 3];
                    hit = 1;
                    tool->touching++;
                }
            }
            if (hit) {
                for (int k = 0; k < 16; k++) {
                    q->in_contact[number * (ny + 1) + node[k] / (nx + 1)] = 1;
                    for (int d = 0; d < 3; d++)
                        f[d * nn + node[k]] += push[d][k];
                }
                for (int k = 0; k < 6; k++)
                    stiffness[k] += per_point * normals[k];
            }
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
    return (height - at[2]) * up + 0.5 * q->thickness_before[q->support_element[k]];
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
    double *R f = q->contact_force + 3 * TOOLS * nn;
    uint8_t *R row = q->in_contact + TOOLS * (q->ny + 1);
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
        const double rub = friction(q, normal, size, q->support_area[k]);
        row[node[0] / (q->nx + 1)] = row[node[2] / (q->nx + 1)] = 1;
        for (int d = 0; d < 3; d++)
            for (int m = 0; m < 4; m++)
                f[d * nn + node[m]] += weight[m] * (normal * n[d] - rub * slip[d]);
    }
}

/* Springs of the clamped edge in the plane, nodes `from` to `to` - 1; beyond its limit of friction an anchor slides after
 * its node. */
static void edges(const Shell *R q, int64_t from, int64_t to) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1);
    for (int64_t k = 0; k < q->spring_size; k++) {
        const int64_t n = q->spring_node[k];
        if (n < from || n >= to)
            continue;
        double dx = q->position[n] - q->anchor[n], dy = q->position[nn + n] - q->anchor[nn + n];
        const double size = sqrt(dx * dx + dy * dy), limit = q->spring_limit[k] / q->spring[k];
        if (size > limit) {
            const double kept = limit / size;
            dx *= kept, dy *= kept;
            q->anchor[n] = q->position[n] - dx, q->anchor[nn + n] = q->position[nn + n] - dy;
        }
        q->force[n] -= q->spring[k] * dx, q->force[nn + n] -= q->spring[k] * dy;
    }
}

/* Nodes `from` to `to` - 1. */
VECTORISED static void move(const Shell *R q, int64_t from, int64_t to) {
    const int64_t nn = (q->nx + 1) * (q->ny + 1);
    const double dt = q->step, kept = 1.0 - q->damping * dt;
    const uint8_t *R fixed = q->fixed;
    const double *R per_mass = q->per_mass, *R per_inertia = q->per_inertia;
    for (int d = 0; d < 3; d++) {
        double *R x = q->position + d * nn, *R v = q->velocity + d * nn, *R w = q->spin + d * nn;
        const double *R f = q->force + d * nn, *R m = q->moment + d * nn;
        const uint8_t bit = (uint8_t)(1 << d), turn = (uint8_t)(8 << d);
        for (int64_t n = from; n < to; n++) {
            v[n] = fixed[n] & bit ? v[n] : kept * v[n] + dt * f[n] * per_mass[n];
            w[n] = fixed[n] & turn ? w[n] : kept * w[n] + dt * m[n] * per_inertia[n];
            x[n] += dt * v[n];
        }
    }
}

/* Steps that one or two threads compute. In a step, first each element and each contact is computed by either of them,
 * then the nodes, half by each: every sum has one order, so that their number does not change a result. */
typedef struct {
    const Shell *q;
    Tool *tools;
    int64_t steps;
    double smoothing;
    int threads;
    atomic_long taken;            /* portions of rows of elements in this step */
    atomic_int waiting, passed;   /* of the barrier */
    double cpu;                   /* s, of the second thread */
    atomic_long yields;           /* times that a thread offered its processor to others while it waited */
    int alone;                    /* the second thread is not waited for any more */
    int64_t near;                 /* points that may touch the support */
} Work;

enum { PORTION = 2 };             /* rows of elements that a thread takes at once */
enum { SPINS = 4000 };            /* looks at a barrier before the processor is offered to others */
enum { CROWDED = 20 };            /* such offers after which the first thread goes on alone: others need the processors */

static void barrier(Work *R w) {
    if (w->threads == 1)
        return;
    const int passed = atomic_load(&w->passed);
    if (atomic_fetch_add(&w->waiting, 1) + 1 == w->threads) {
        atomic_store(&w->waiting, 0);
        atomic_store(&w->passed, passed + 1);
        return;
    }
    for (int k = 0; atomic_load_explicit(&w->passed, memory_order_acquire) == passed; k++)
        if (k >= SPINS) {
            atomic_fetch_add_explicit(&w->yields, 1, memory_order_relaxed);
            sched_yield();
        }
}

static void keep_thickness(const Shell *R q, int64_t from, int64_t to) {
    to = to < q->ny ? to : q->ny;
    memcpy(q->thickness_before + from * q->nx, q->thickness + from * q->nx, sizeof(double) * (size_t)((to - from) * q->nx));
}

/* One step of the machine that gives way: `felt` follows `force` with the time of `smoothing`, as a spring beside a damper.
 *
 * The force falls by stiffness times what the tool gives way, which is taken into the step: with the force from before
 * it, contact (K) on a soft machine (C) would swing from step to step, and make energy, where smoothing K C exceeds 2.
 * (1 + smoothing K C) change = smoothing (force - felt), by Cramer's rule. */
static void give_way(Tool *R tool, const double *R force, const double *R K, double smoothing) {
    static const int64_t PLACE[3][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}};
    double m[3][3], minor[3][3], right[3];
    for (int i = 0; i < 3; i++) {
        right[i] = smoothing * (force[i] - tool->felt[i]);
        for (int j = 0; j < 3; j++)
            m[i][j] = (i == j ? 1.0 : 0.0) + smoothing * K[PLACE[i][j]] * tool->compliance[j];
    }
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, d = (j + 2) % 3;
            minor[i][j] = m[a][c] * m[b][d] - m[a][d] * m[b][c];
        }
    const double inverse = 1.0 / (m[0][0] * minor[0][0] + m[0][1] * minor[0][1] + m[0][2] * minor[0][2]);
    for (int j = 0; j < 3; j++)
        tool->felt[j] += inverse * (minor[0][j] * right[0] + minor[1][j] * right[1] + minor[2][j] * right[2]);
}

/* Contact of tool t in step k, and what it and its machine feel. */
static void of_tool(const Work *R w, int t, int64_t k) {
    Tool *R tool = w->tools + t;
    if (tool->radius <= 0.0)
        return;
    const double steps = (double)w->steps;
    double centre[3], speed[3], force[3], stiffness[6];
    for (int d = 0; d < 3; d++) {
        speed[d] = (tool->end[d] - tool->begin[d]) / (steps * w->q->step);
        centre[d] = tool->begin[d] + (tool->end[d] - tool->begin[d]) * ((double)k / steps) +
            tool->compliance[d] * tool->felt[d];
    }
    touch(w->q, tool, t, centre, speed, force, stiffness);
    give_way(tool, force, stiffness, w->smoothing);
    for (int d = 0; d < 3; d++)
        tool->mean[d] += force[d] / steps;
}

static void compute(Work *w, int thread) {
    const Shell *q = w->q;
    const int64_t portions = (q->ny + PORTION - 1) / PORTION, rows = q->ny + 1, half = rows / 2;
    const int64_t first = thread ? half : 0;
    for (int64_t k = 1; k <= w->steps; k++) {
        const double offset = q->support_from + (q->support_to - q->support_from) * ((double)k / (double)w->steps);
        const int lone = w->threads == 1;
        const int64_t after = lone || thread ? rows : half;
        for (int t = 0; t < TOOLS; t++)
            if (lone || t % 2 == thread)
                of_tool(w, t, k);
        if (lone || thread) {
            if (k % LOOK == 1)
                w->near = near_support(q, offset);
            support(q, w->near, offset);
        }
        /* one thread from the first row on, the other from the last: each finds most of its rows in its own cache */
        for (int64_t mine = 0; atomic_fetch_add(&w->taken, 1) < portions; mine++) {
            const int64_t from = PORTION * (thread ? portions - 1 - mine : mine);
            const int64_t to = from + PORTION < q->ny ? from + PORTION : q->ny;
            elements(q, from, to);
            if (q->support_plane)
                planes(q, offset, from, to);
        }
        barrier(w);
        if (!thread)
            atomic_store(&w->taken, 0);
        assemble(q, first, after);
        edges(q, first * (q->nx + 1), after * (q->nx + 1));
        move(q, first * (q->nx + 1), after * (q->nx + 1));
        keep_thickness(q, first, after);
        if (!thread)
            w->alone = atomic_load(&w->yields) >= CROWDED;
        barrier(w);
        if (w->alone && thread)
            return;
        if (w->alone)
            w->threads = 1;
    }
}

static void *second(void *work) {
    struct timespec used;
    compute(work, 1);
    if (clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used) == 0)
        ((Work *)work)->cpu = (double)used.tv_sec + 1e-9 * (double)used.tv_nsec;
    return NULL;
}

/* `steps` steps on one or two `threads`, while the tools go from begin to end; a tool of radius 0 is not there. `cpu`: out,
 * s of the processor that the second thread took. Returns whether it ended early since others need the processors. */
int64_t isf_shell_advance(const Shell *q, Tool *tools, int64_t steps, double smoothing, int64_t threads, double *cpu) {
    Work work = {.q = q, .tools = tools, .steps = steps, .smoothing = smoothing, .threads = threads > 1 ? 2 : 1};
    pthread_t other;
    for (int t = 0; t < TOOLS; t++)
        memset(tools[t].mean, 0, sizeof tools[t].mean);
    keep_thickness(q, 0, q->ny);
    if (work.threads == 2 && pthread_create(&other, NULL, second, &work) != 0)
        work.threads = 1; /* no thread to be had */
    const int joined = work.threads == 2;
    compute(&work, 0);
    if (joined)
        pthread_join(other, NULL);
    *cpu = work.cpu;
    return work.alone;
}

/* An empty module, so that Python finds and loads the library as it does any other; see library.py. */
PyMODINIT_FUNC PyInit__shell(void) {
    static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_shell", NULL, -1, NULL, NULL, NULL, NULL, NULL};
    return PyModule_Create(&module);
}
