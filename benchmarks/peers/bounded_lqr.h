/* Bounded LQRs for a solver in C: reads them, times a function that solves one of them, writes what it found.

   Reads N nx nu count u_max tolerance mode, then A, B (by columns), b and the initial states; H is the identity.
   The initial state is put into the first offset, so that it is no variable. Writes milliseconds for all without and
   with the adjoint, how many it calls solved, the mean number of iterations, and all controls. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define REPETITIONS 20

typedef struct {
  int N, nx, nu, count, mode, *index;
  double u_max, tolerance;
  double *A, *B, *b, *x0;                               /* given */
  double *Q, *R, *low, *high, *none, *one, *first, *u;  /* `first`: offset of the first step; `u`: all controls */
} bounded_lqr;

static double seconds(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

static double *numbers(int count) {
  double *values = malloc(sizeof(double) * count);
  for (int i = 0; i < count; ++i)
    if (scanf("%lf", values + i) != 1) exit(1);
  return values;
}

static double *filled(int count, double value) {
  double *values = malloc(sizeof(double) * (count + 1));
  for (int i = 0; i < count; ++i) values[i] = value;
  return values;
}

static double *identity(int size) {
  double *values = filled(size * size, 0);
  for (int i = 0; i < size; ++i) values[i * size + i] = 1;
  return values;
}

static bounded_lqr read_problems(void) {
  bounded_lqr p;
  if (scanf("%d %d %d %d %lf %lf %d", &p.N, &p.nx, &p.nu, &p.count, &p.u_max, &p.tolerance, &p.mode) != 7) exit(1);
  p.A = numbers(p.nx * p.nx), p.B = numbers(p.nx * p.nu), p.b = numbers(p.nx), p.x0 = numbers(p.count * p.nx);
  p.Q = identity(p.nx), p.R = identity(p.nu), p.none = filled(p.nx, 0), p.one = filled(p.nu, 1);
  p.low = filled(p.nu, -p.u_max), p.high = filled(p.nu, p.u_max);
  p.first = filled(p.nx, 0), p.u = filled(p.count * p.N * p.nu, 0);
  p.index = malloc(sizeof(int) * p.nu);
  for (int i = 0; i < p.nu; ++i) p.index[i] = i;
  return p;
}

/* `solve(p, u, with_adjoint, &iterations)` solves the problem with the offset p->first; whether it says so */
typedef int (*bounded_lqr_solver)(const bounded_lqr *p, double *u, int with_adjoint, int *iterations);

static int measure(bounded_lqr *p, bounded_lqr_solver solve) {
  double fastest[2] = {1e9, 1e9};
  int solved = 0, width = p->N * p->nu;
  long iterations = 0;
  for (int with_adjoint = 0; with_adjoint < 2; ++with_adjoint)
    for (int run = 0; run < REPETITIONS; ++run) {
      double start = seconds(), taken;
      solved = 0;
      iterations = 0;
      for (int i = 0; i < p->count; ++i) {
        int each = 0;
        for (int j = 0; j < p->nx; ++j) {
          p->first[j] = p->b[j];
          for (int k = 0; k < p->nx; ++k) p->first[j] += p->A[k * p->nx + j] * p->x0[i * p->nx + k];
        }
        solved += solve(p, p->u + i * width, with_adjoint, &each);
        iterations += each;
      }
      taken = seconds() - start;
      if (taken < fastest[with_adjoint]) fastest[with_adjoint] = taken;
    }
  printf("%.9g %.9g %d %.9g\n", 1e3 * fastest[0], 1e3 * fastest[1], solved, (double)iterations / p->count);
  for (int i = 0; i < p->count * width; ++i) printf("%.17g\n", p->u[i]);
  return 0;
}
