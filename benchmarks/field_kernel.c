/* The same sum as fluxtwin.sim.field_kernels in C without intrinsics, as fast as we know how: as many points as fill
   vectors of the machine's own width, all six sums of an order kept in registers. Wider vectors than the machine has, or more
   groups than its registers hold, go through memory: 64-byte vectors on AVX2 took 34 times as long. For the benchmark only. */
#include <math.h>

#ifndef LANES
#if defined(__AVX512F__)
#define LANES 8
#define GROUPS 2
#elif defined(__AVX__)
#define LANES 4
#define GROUPS 1
#else
#define LANES 2
#define GROUPS 2
#endif
#endif
#define POINTS (LANES * GROUPS)
typedef double vec __attribute__((vector_size(8 * LANES)));

void synthesize(const double *restrict r, const double *restrict table, long top, long count, double *restrict out)
{
    const double a = 6371.2;
    for (long start = 0; start < count; start += POINTS) {
        vec u[GROUPS], v[GROUPS], w[GROUPS], q[GROUPS], A[GROUPS], B[GROUPS], b[3][GROUPS];
        for (int g = 0; g < GROUPS; g++)
            for (int j = 0; j < LANES; j++) {
                long i = start + g * LANES + j;
                if (i >= count) i = count - 1;
                const double x = r[3 * i], y = r[3 * i + 1], z = r[3 * i + 2];
                const double s = a / (x * x + y * y + z * z);
                u[g][j] = x * s; v[g][j] = y * s; w[g][j] = z * s; q[g][j] = a * s;
                A[g][j] = sqrt(a * s); B[g][j] = 0.0;
                b[0][g][j] = b[1][g][j] = b[2][g][j] = 0.0;
            }
        const double *row = table;
        for (long m = 0; m <= top; m++) {
            vec sum[6][GROUPS], before[GROUPS], p[GROUPS];
            for (int g = 0; g < GROUPS; g++) {
                for (int k = 0; k < 6; k++) sum[k][g] = (vec){0} + row[k + 1];
                before[g] = (vec){0} + 1.0;
                p[g] = w[g]; /* of k = m it is 1 */
            }
            row += 7;
            for (long k = m + 1; k <= top; k++, row += 7)
                for (int g = 0; g < GROUPS; g++) {
                    const vec now = p[g];
                    for (int j = 0; j < 6; j++) sum[j][g] += row[j + 1] * now;
                    p[g] = w[g] * now - row[0] * q[g] * before[g];
                    before[g] = now;
                }
            for (int g = 0; g < GROUPS; g++) {
                for (int j = 0; j < 3; j++) b[j][g] += sum[2 * j][g] * A[g] + sum[2 * j + 1][g] * B[g];
                const vec next = u[g] * A[g] - v[g] * B[g];
                B[g] = u[g] * B[g] + v[g] * A[g];
                A[g] = next;
            }
        }
        for (int g = 0; g < GROUPS; g++)
            for (int j = 0; j < LANES && start + g * LANES + j < count; j++)
                for (int k = 0; k < 3; k++) out[3 * (start + g * LANES + j) + k] = b[k][g][j];
    }
}
