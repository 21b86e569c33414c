/* Bounded LQRs by the module of acados for quadratic programs, with partial condensing: the rest is as in hpipm.c.

   `adjoint` is the module's adjoint sensitivity of the solution, with the factorisation of the solution. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include <acados_c/ocp_qp_interface.h>
#include <hpipm_d_ocp_qp_seed.h>
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

  ocp_qp_solver_plan_t plan = {PARTIAL_CONDENSING_HPIPM};
  ocp_qp_xcond_solver_config *config = ocp_qp_xcond_solver_config_create(plan);
  ocp_qp_xcond_solver_dims *dims = ocp_qp_xcond_solver_dims_create(config, N);
  for (int t = 0; t <= N; ++t) {
    int states = t ? nx : 0, controls = t < N ? nu : 0, zero = 0;
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nx", &states);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nu", &controls);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nbu", &controls);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nbx", &zero);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "ng", &zero);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "ns", &zero);
  }
  void *options = ocp_qp_xcond_solver_opts_create(config, dims);
  int most = 200, blocks = mode;
  ocp_qp_xcond_solver_opts_set(config, options, "iter_max", &most);
  ocp_qp_xcond_solver_opts_set(config, options, "cond_N", &blocks);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_stat", &tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_eq", &tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_ineq", &tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_comp", &tolerance);
  ocp_qp_in *qp = ocp_qp_in_create_from_xcond_dims(dims);
  ocp_qp_out *sol = ocp_qp_out_create_from_xcond_dims(dims), *sens = ocp_qp_out_create_from_xcond_dims(dims);
  ocp_qp_solver *solver = ocp_qp_create(config, dims, options);
  ocp_qp_seed *seed = ocp_qp_seed_assign(dims->orig_dims, malloc(ocp_qp_seed_calculate_size(dims->orig_dims)));
  d_ocp_qp_seed_set_zero(seed);
  d_ocp_qp_seed_set_seed_r(0, one, seed);
  for (int t = 0; t <= N; ++t) {
    if (t < N) {
      if (t) ocp_qp_in_set(config, qp, t, "A", A);
      ocp_qp_in_set(config, qp, t, "B", B);
      ocp_qp_in_set(config, qp, t, "b", b);
      ocp_qp_in_set(config, qp, t, "R", R);
      ocp_qp_in_set(config, qp, t, "r", none);
      ocp_qp_in_set(config, qp, t, "idxbu", index);
      ocp_qp_in_set(config, qp, t, "lbu", low);
      ocp_qp_in_set(config, qp, t, "ubu", high);
    }
    if (t) {
      ocp_qp_in_set(config, qp, t, "Q", Q);
      ocp_qp_in_set(config, qp, t, "q", none);
    }
  }

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
        ocp_qp_in_set(config, qp, 0, "b", first);
        int status = ocp_qp_solve(solver, qp, sol), each = ((qp_info *)sol->misc)->num_iter;
        solved += status == 0;
        iterations += each;
        for (int t = 0; t < N; ++t) ocp_qp_out_get(sol, t, "u", u + (i * N + t) * nu);
        if (with_adjoint) config->eval_adj_sens(config, dims, qp, seed, sens, solver->opts, solver->mem, solver->work);
      }
      double taken = seconds() - start;
      if (with_adjoint && taken < fastest_both) fastest_both = taken;
      if (!with_adjoint && taken < fastest) fastest = taken;
    }
  printf("%.9g %.9g %d %.9g\n", 1e3 * fastest, 1e3 * fastest_both, solved, (double)iterations / count);
  for (int i = 0; i < count * N * nu; ++i) printf("%.17g\n", u[i]);
  return 0;
}
