/* The batch evaluation and the square-root filter of `kernels.arclengths`, for the camera model inverted_wang, in C.

   A peer of `benchmarks`, compiled where a C compiler is found: gcc -O3 -march=native, once with IEEE arithmetic and once with
   -ffast-math. It does the same arithmetic in the same order of operations, on one thread, with scratch space on the stack; the
   derivations stand in the kernels' module. Nothing else uses it. */

#include <math.h>
#include <string.h>

enum { N = 8, STAR = 20, BAND = 5, MOST_STARS = 256, MOST_ARCS = 2 * MOST_STARS, HALVINGS = 6 };

typedef struct { double w[MOST_STARS][STAR]; } stars;

static void star(const double *x, double pitch, double row, double col, double *restrict w)
{
    const double f = x[0], b4 = x[3], b2 = x[4], a1 = x[5], a2 = x[6], g = x[7];
    const double u = pitch * (row - x[1]), dn = col - x[2], v = g * pitch * dn;
    const double inverse = 1.0 / (a1 * v + a2 * u + f);
    const double U = u * f * inverse, V = v * f * inverse, rho2 = U * U + V * V, over_f = 1.0 / f;
    const double B = over_f * (1.0 + rho2 * (b2 + rho2 * b4)), slope = over_f * (2.0 * b2 + 4.0 * b4 * rho2);
    const double tx = B * U, ty = B * V;
    const double xx = B + slope * U * U, xy = slope * U * V, yy = B + slope * V * V, fd2 = f * inverse * inverse;
    const double u_u = fd2 * (a1 * v + f), u_v = -fd2 * a1 * u, v_u = -fd2 * a2 * v, v_v = fd2 * (a2 * u + f);
    const double along_x = xx * u + xy * v, along_y = xy * u + yy * v, tilted = (a1 * v + a2 * u) * inverse * inverse;
    const double col_x = pitch * (xx * u_v + xy * v_v), col_y = pitch * (xy * u_v + yy * v_v);
    const double radial_x = rho2 * U * over_f, radial_y = rho2 * V * over_f;
    const double norm = 1.0 / sqrt(tx * tx + ty * ty + 1.0);
    w[0] = tx * norm; w[1] = ty * norm; w[2] = norm; w[3] = norm;
    w[4] = tilted * along_x - tx * over_f; w[12] = tilted * along_y - ty * over_f;
    w[5] = -pitch * (xx * u_u + xy * v_u); w[13] = -pitch * (xy * u_u + yy * v_u);
    w[6] = -g * col_x; w[14] = -g * col_y;
    w[7] = rho2 * radial_x; w[15] = rho2 * radial_y;
    w[8] = radial_x; w[16] = radial_y;
    w[9] = -fd2 * v * along_x; w[17] = -fd2 * v * along_y;
    w[10] = -fd2 * u * along_x; w[18] = -fd2 * u * along_y;
    w[11] = dn * col_x; w[19] = dn * col_y;
}

static void direction(const double *x, double pitch, double row, double col, double *restrict w)
{
    const double f = x[0], u = pitch * (row - x[1]), v = x[7] * pitch * (col - x[2]);
    const double inverse = 1.0 / (x[5] * v + x[6] * u + f);
    const double U = u * f * inverse, V = v * f * inverse, rho2 = U * U + V * V;
    const double B = (1.0 + rho2 * (x[4] + rho2 * x[3])) / f, tx = B * U, ty = B * V;
    const double norm = 1.0 / sqrt(tx * tx + ty * ty + 1.0);
    w[0] = tx * norm; w[1] = ty * norm; w[2] = norm;
}

static double arclength(const double *p, const double *q, double *cosine, double *sine)
{
    const double cx = p[1] * q[2] - p[2] * q[1], cy = p[2] * q[0] - p[0] * q[2], cz = p[0] * q[1] - p[1] * q[0];
    *sine = sqrt(cx * cx + cy * cy + cz * cz);
    *cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    return atan2(*sine, *cosine);
}

static double rows(const double *x, double pitch, int n, const double *row, const double *col, const double *phi,
                   const double *band, int n_free, const long *free, const double *scale, stars *s,
                   double *restrict e, double (*restrict H)[N])
{
    double total = 0.0;
    for (int i = 0; i < n; i++) star(x, pitch, row[i], col[i], s->w[i]);
    for (int a = 0; a < 2 * n - 3; a++) {
        const int i = a / 2, j = i + 1 + a % 2, first = a < 4 ? 0 : a - 4;
        const double *p = s->w[i], *q = s->w[j], *L = band + BAND * a;
        double c, sine, full[N], h[N] = {0};
        double residual = arclength(p, q, &c, &sine) - phi[a];
        const double ki = p[3] / sine, kj = q[3] / sine;
        const double ix = ki * (c * p[0] - q[0]), iy = ki * (c * p[1] - q[1]);
        const double jx = kj * (c * q[0] - p[0]), jy = kj * (c * q[1] - p[1]);
        for (int k = 0; k < N; k++) full[k] = ix * p[4 + k] + iy * p[12 + k] + jx * q[4 + k] + jy * q[12 + k];
        total += residual * residual;
        const double inverse = 1.0 / L[4];
        for (int b = first; b < a; b++) residual -= L[4 - a + b] * e[b];
        e[a] = residual * inverse;
        for (int k = 0; k < n_free; k++) h[k] = full[free[k]] * scale[k];
        for (int b = first; b < a; b++) {
            const double share = L[4 - a + b];
            for (int k = 0; k < N; k++) h[k] -= share * H[b][k];
        }
        for (int k = 0; k < N; k++) H[a][k] = h[k] * inverse;
    }
    return total;
}

static double whitened(const double *x, double pitch, int n, const double *row, const double *col, const double *phi,
                       const double *band, stars *s, double *restrict e)
{
    double total = 0.0, c, sine;
    for (int i = 0; i < n; i++) direction(x, pitch, row[i], col[i], s->w[i]);
    for (int a = 0; a < 2 * n - 3; a++) {
        const int i = a / 2, first = a < 4 ? 0 : a - 4;
        const double *L = band + BAND * a;
        double residual = arclength(s->w[i], s->w[i + 1 + a % 2], &c, &sine) - phi[a];
        total += residual * residual;
        for (int b = first; b < a; b++) residual -= L[4 - a + b] * e[b];
        e[a] = residual / L[4];
    }
    return total;
}

/* A (n_free, n_free) and b (n_free,) of all exposures; costs = chi-square and the unweighted sum of squares. */
void normal_equations(const double *x, double pitch, long exposures, const long *start, const double *row, const double *col,
                      const double *phi, const double *band, long n_free, const long *free, const double *scale,
                      double *A, double *b, double *costs)
{
    static _Thread_local stars s;
    double e[MOST_ARCS], H[MOST_ARCS][N], sum[N][N] = {{0}}, right[N] = {0}, chi2 = 0.0, total = 0.0;
    for (long k = 0; k < exposures; k++) {
        const long s0 = start[k], a0 = 2 * s0 - 3 * k;
        const int n = (int)(start[k + 1] - s0);
        total += rows(x, pitch, n, row + s0, col + s0, phi + a0, band + BAND * a0, (int)n_free, free, scale, &s, e, H);
        for (int a = 0; a < 2 * n - 3; a++) {
            chi2 += e[a] * e[a];
            for (int p = 0; p < N; p++) {
                right[p] += H[a][p] * e[a];
                for (int q = 0; q <= p; q++) sum[p][q] += H[a][p] * H[a][q];
            }
        }
    }
    for (int p = 0; p < n_free; p++) {
        b[p] = right[p];
        for (int q = 0; q <= p; q++) A[p * n_free + q] = A[q * n_free + p] = sum[p][q];
    }
    costs[0] = chi2;
    costs[1] = total;
}

/* S is kept by columns: S[j][i] is row i of column j. */
static double carlson(double *restrict z, double (*restrict S)[N], const double *h, double innovation)
{
    double f[N], gain[N] = {0}, alpha = 1.0;
    for (int j = 0; j < N; j++) {
        f[j] = 0.0;
        for (int i = 0; i < N; i++) f[j] += S[j][i] * h[i];
    }
    for (int j = 0; j < N; j++) {
        const double before = alpha;
        alpha += f[j] * f[j];
        const double root = 1.0 / sqrt(before * alpha), keep = before * root, move = f[j] * root;
        for (int i = 0; i < N; i++) {
            const double old = S[j][i];
            S[j][i] = keep * old - move * gain[i];
            gain[i] += old * f[j];
        }
    }
    for (int i = 0; i < N; i++) z[i] -= gain[i] / alpha * innovation;
    return innovation * innovation / alpha;
}

static double prior_cost(double (*S)[N], const double *z, const double *z_prior, int n_free)
{
    double cost = 0.0, y[N];
    for (int i = n_free - 1; i >= 0; i--) {
        double value = z[i] - z_prior[i];
        for (int j = i + 1; j < n_free; j++) value -= S[j][i] * y[j];
        y[i] = value / S[i][i];
        cost += y[i] * y[i];
    }
    return cost;
}

/* Without process noise and forgetting. Fills per frame what the product's loop fills; x (8,), z (8,) and S change in place. */
void square_root_filter(double *x, double *z, double (*S)[N], double pitch, long frames, const long *frame_start,
                        const long *start, const double *row, const double *col, const double *phi, const double *band,
                        long n_free, const long *free, const double *scale, long linearisations, double rest,
                        double *states, double *sigmas, double *nis, double *squares)
{
    static _Thread_local stars s;
    double e[2 * MOST_ARCS], post[2 * MOST_ARCS], H[2 * MOST_ARCS][N], x0[N], z_prior[N], z_at[N], S_prior[N][N];
    for (int p = 0; p < n_free; p++) x0[p] = x[free[p]] - scale[p] * z[p];
    for (long k = 0; k < frames; k++) {
        double total = 0.0, frame_nis = 0.0;
        memcpy(z_prior, z, sizeof z_prior);
        memcpy(S_prior, S, sizeof S_prior);
        for (long turn = 0; turn < linearisations; turn++) {
            int arcs = 0;
            memcpy(z_at, z, sizeof z_at);
            for (long m = frame_start[k]; m < frame_start[k + 1]; m++) {
                const long s0 = start[m], a0 = 2 * s0 - 3 * m;
                const int n = (int)(start[m + 1] - s0);
                rows(x, pitch, n, row + s0, col + s0, phi + a0, band + BAND * a0, (int)n_free, free, scale, &s, e + arcs, H + arcs);
                arcs += 2 * n - 3;
            }
            memcpy(z, z_prior, sizeof z_prior);
            memcpy(S, S_prior, sizeof S_prior);
            frame_nis = 0.0;
            for (int a = 0; a < arcs; a++) {
                double innovation = e[a];
                for (int p = 0; p < N; p++) innovation += H[a][p] * (z[p] - z_at[p]);
                frame_nis += carlson(z, S, H[a], innovation);
            }
            for (int p = 0; p < n_free; p++) x[free[p]] = x0[p] + scale[p] * z[p];
            double before = prior_cost(S_prior, z_at, z_prior, (int)n_free);
            for (int a = 0; a < arcs; a++) before += e[a] * e[a];
            for (int halving = 0; halving < HALVINGS; halving++) {
                int done = 0;
                total = 0.0;
                for (long m = frame_start[k]; m < frame_start[k + 1]; m++) {
                    const long s0 = start[m], a0 = 2 * s0 - 3 * m;
                    const int n = (int)(start[m + 1] - s0);
                    total += whitened(x, pitch, n, row + s0, col + s0, phi + a0, band + BAND * a0, &s, post + done);
                    done += 2 * n - 3;
                }
                double after = prior_cost(S_prior, z, z_prior, (int)n_free);
                for (int a = 0; a < arcs; a++) after += post[a] * post[a];
                if (after <= before * (1.0 + 1e-9)) break;
                for (int p = 0; p < n_free; p++) {
                    z[p] = 0.5 * (z[p] + z_at[p]);
                    x[free[p]] = x0[p] + scale[p] * z[p];
                }
            }
            double worst = 0.0;
            for (int a = 0; a < arcs; a++) {
                double predicted = e[a];
                for (int p = 0; p < N; p++) predicted += H[a][p] * (z[p] - z_at[p]);
                worst = fmax(worst, fabs(post[a] - predicted));
            }
            if (worst < rest) break;
        }
        memcpy(states + N * k, x, N * sizeof *x);
        for (int p = 0; p < n_free; p++) {
            double variance = 0.0;
            for (int j = p; j < n_free; j++) variance += S[j][p] * S[j][p];
            sigmas[n_free * k + p] = sqrt(variance);
        }
        nis[k] = frame_nis;
        squares[k] = total;
    }
}
