/* Bounded LQRs by HPIPM, the solver of quadratic programs inside of acados: milliseconds and controls of all instances.

   Reads N nx nu count u_max tolerance mode, then A, B (by columns), b and the initial states; H is the identity.
   The initial state is put into the first offset, so that it is no variable. `adjoint` is the linear system of the
   sensitivities alone, with the factorisation of the solution; what acados makes of it takes time besides. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <blasfeo_d_aux_ext_dep.h>
#include <hpipm_d_ocp_qp.h>
#include <hpipm_d_ocp_qp_dim.h>
#include <hpipm_d_ocp_qp_ipm.h>
#include <hpipm_d_ocp_qp_seed.h>
#include <hpipm_d_ocp_qp_sol.h>

#define REPETITIONS 20

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

int main(void) {
  int N, nx, nu, count, mode;
  double u_max, tolerance;
  if (scanf("%d %d %d %d %lf %lf %d", &N, &nx, &nu, &count, &u_max, &tolerance, &mode) != 7) return 1;
  double *A = numbers(nx * nx), *B = numbers(nx * nu), *b = numbers(nx), *x0 = numbers(count * nx);
  double *Q = identity(nx), *R = identity(nu), *low = filled(nu, -u_max), *high = filled(nu, u_max), *none = filled(nx, 0);
  double *one = filled(nu, 1), *u = filled(count * N * nu, 0), *first = filled(nx, 0);
  int *index = malloc(sizeof(int) * nu);
  for (int i = 0; i < nu; ++i) index[i] = i;

  struct d_ocp_qp_dim dim;
  d_ocp_qp_dim_create(N, &dim, malloc(d_ocp_qp_dim_memsize(N)));
  for (int t = 0; t <= N; ++t) {
    d_ocp_qp_dim_set_nx(t, t ? nx : 0, &dim);
    d_ocp_qp_dim_set_nu(t, t < N ? nu : 0, &dim);
    d_ocp_qp_dim_set_nbu(t, t < N ? nu : 0, &dim);
    d_ocp_qp_dim_set_nbx(t, 0, &dim);
    d_ocp_qp_dim_set_ng(t, 0, &dim);
    d_ocp_qp_dim_set_ns(t, 0, &dim);
  }
  struct d_ocp_qp qp;
  d_ocp_qp_create(&dim, &qp, malloc(d_ocp_qp_memsize(&dim)));
  for (int t = 0; t <= N; ++t) {
    if (t < N) {
      if (t) d_ocp_qp_set_A(t, A, &qp);
      d_ocp_qp_set_B(t, B, &qp);
      d_ocp_qp_set_b(t, b, &qp);
      d_ocp_qp_set_R(t, R, &qp);
      d_ocp_qp_set_r(t, none, &qp);
      d_ocp_qp_set_idxbu(t, index, &qp);
      d_ocp_qp_set_lbu(t, low, &qp);
      d_ocp_qp_set_ubu(t, high, &qp);
    }
    if (t) {
      d_ocp_qp_set_Q(t, Q, &qp);
      d_ocp_qp_set_q(t, none, &qp);
    }
  }
  struct d_ocp_qp_sol sol, sens;
  d_ocp_qp_sol_create(&dim, &sol, malloc(d_ocp_qp_sol_memsize(&dim)));
  d_ocp_qp_sol_create(&dim, &sens, malloc(d_ocp_qp_sol_memsize(&dim)));
  struct d_ocp_qp_seed seed;
  d_ocp_qp_seed_create(&dim, &seed, malloc(d_ocp_qp_seed_memsize(&dim)));
  d_ocp_qp_seed_set_zero(&seed);
  d_ocp_qp_seed_set_seed_r(0, one, &seed);
  struct d_ocp_qp_ipm_arg arg;
  d_ocp_qp_ipm_arg_create(&dim, &arg, malloc(d_ocp_qp_ipm_arg_memsize(&dim)));
  d_ocp_qp_ipm_arg_set_default(mode, &arg);
  int most = 200;
  d_ocp_qp_ipm_arg_set_iter_max(&most, &arg);
  d_ocp_qp_ipm_arg_set_tol_stat(&tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_eq(&tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_ineq(&tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_comp(&tolerance, &arg);
  struct d_ocp_qp_ipm_ws ws;
  d_ocp_qp_ipm_ws_create(&dim, &arg, &ws, malloc(d_ocp_qp_ipm_ws_memsize(&dim, &arg)));

  double fastest = 1e9, fastest_both = 1e9;
  int solved = 0;
  long iterations = 0;
  for (int with_adjoint = 0; with_adjoint < 2; ++with_adjoint)
    for (int run = 0; run < REPETITIONS; ++run) {
      double start = seconds();
      solved = 0;
      iterations = 0;
      for (int i = 0; i < count; ++i) {
        for (int j = 0; j < nx; ++j) {
          first[j] = b[j];
          for (int k = 0; k < nx; ++k) first[j] += A[k * nx + j] * x0[i * nx + k];
        }
        d_ocp_qp_set_b(0, first, &qp);
        d_ocp_qp_ipm_solve(&qp, &sol, &arg, &ws);
        int status, each;
        d_ocp_qp_ipm_get_status(&ws, &status);
        d_ocp_qp_ipm_get_iter(&ws, &each);
        solved += status == 0;
        iterations += each;
        for (int t = 0; t < N; ++t) d_ocp_qp_sol_get_u(t, &sol, u + (i * N + t) * nu);
        if (with_adjoint) d_ocp_qp_ipm_sens_adj(&qp, &seed, &sens, &arg, &ws);
      }
      double taken = seconds() - start;
      if (with_adjoint && taken < fastest_both) fastest_both = taken;
      if (!with_adjoint && taken < fastest) fastest = taken;
    }
  printf("%.9g %.9g %d %.9g\n", 1e3 * fastest, 1e3 * fastest_both, solved, (double)iterations / count);
  for (int i = 0; i < count * N * nu; ++i) printf("%.17g\n", u[i]);
  return 0;
}
