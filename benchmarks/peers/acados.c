/* Bounded LQRs by the module of acados for quadratic programs, with partial condensing to `mode` blocks.

   `adjoint` is the module's adjoint sensitivity of the solution, with the factorisation of the solution. */
#include <acados_c/ocp_qp_interface.h>
#include <hpipm_d_ocp_qp_seed.h>

#include "bounded_lqr.h"

static ocp_qp_xcond_solver_config *config;
static ocp_qp_xcond_solver_dims *dims;
static ocp_qp_in *qp;
static ocp_qp_out *sol, *sens;
static ocp_qp_solver *solver;
static ocp_qp_seed *seed;

static int solve(const bounded_lqr *p, double *u, int with_adjoint, int *iterations) {
  ocp_qp_in_set(config, qp, 0, "b", p->first);
  int status = ocp_qp_solve(solver, qp, sol);
  *iterations = ((qp_info *)sol->misc)->num_iter;
  for (int t = 0; t < p->N; ++t) ocp_qp_out_get(sol, t, "u", u + t * p->nu);
  if (with_adjoint) config->eval_adj_sens(config, dims, qp, seed, sens, solver->opts, solver->mem, solver->work);
  return status == 0;
}

static void set_sizes(const bounded_lqr *p) {
  for (int t = 0; t <= p->N; ++t) {
    int states = t ? p->nx : 0, controls = t < p->N ? p->nu : 0, zero = 0;
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nx", &states);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nu", &controls);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nbu", &controls);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "nbx", &zero);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "ng", &zero);
    ocp_qp_xcond_solver_dims_set(config, dims, t, "ns", &zero);
  }
}

static void set_stages(const bounded_lqr *p) {
  for (int t = 0; t <= p->N; ++t) {
    if (t < p->N) {
      if (t) ocp_qp_in_set(config, qp, t, "A", p->A);
      ocp_qp_in_set(config, qp, t, "B", p->B);
      ocp_qp_in_set(config, qp, t, "b", p->b);
      ocp_qp_in_set(config, qp, t, "R", p->R);
      ocp_qp_in_set(config, qp, t, "r", p->none);
      ocp_qp_in_set(config, qp, t, "idxbu", p->index);
      ocp_qp_in_set(config, qp, t, "lbu", p->low);
      ocp_qp_in_set(config, qp, t, "ubu", p->high);
    }
    if (t) {
      ocp_qp_in_set(config, qp, t, "Q", p->Q);
      ocp_qp_in_set(config, qp, t, "q", p->none);
    }
  }
}

int main(void) {
  bounded_lqr p = read_problems();
  ocp_qp_solver_plan_t plan = {PARTIAL_CONDENSING_HPIPM};
  config = ocp_qp_xcond_solver_config_create(plan);
  dims = ocp_qp_xcond_solver_dims_create(config, p.N);
  set_sizes(&p);
  void *options = ocp_qp_xcond_solver_opts_create(config, dims);
  int most = 200, blocks = p.mode;
  ocp_qp_xcond_solver_opts_set(config, options, "iter_max", &most);
  ocp_qp_xcond_solver_opts_set(config, options, "cond_N", &blocks);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_stat", &p.tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_eq", &p.tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_ineq", &p.tolerance);
  ocp_qp_xcond_solver_opts_set(config, options, "tol_comp", &p.tolerance);
  qp = ocp_qp_in_create_from_xcond_dims(dims);
  sol = ocp_qp_out_create_from_xcond_dims(dims);
  sens = ocp_qp_out_create_from_xcond_dims(dims);
  solver = ocp_qp_create(config, dims, options);
  seed = ocp_qp_seed_assign(dims->orig_dims, malloc(ocp_qp_seed_calculate_size(dims->orig_dims)));
  d_ocp_qp_seed_set_zero(seed);
  d_ocp_qp_seed_set_seed_r(0, p.one, seed);
  set_stages(&p);
  return measure(&p, solve);
}
