/* Bounded LQRs by HPIPM, the solver of quadratic programs inside of acados, in its mode `mode`.

   `adjoint` is the linear system of the sensitivities alone, with the factorisation of the solution; what acados makes
   of it takes time besides. */
#include <stdlib.h>

#include <blasfeo_d_aux_ext_dep.h>
#include <hpipm_d_ocp_qp.h>
#include <hpipm_d_ocp_qp_dim.h>
#include <hpipm_d_ocp_qp_ipm.h>
#include <hpipm_d_ocp_qp_seed.h>
#include <hpipm_d_ocp_qp_sol.h>

#include "bounded_lqr.h"

static struct d_ocp_qp_dim dim;
static struct d_ocp_qp qp;
static struct d_ocp_qp_sol sol, sens;
static struct d_ocp_qp_seed seed;
static struct d_ocp_qp_ipm_arg arg;
static struct d_ocp_qp_ipm_ws ws;

static int solve(const bounded_lqr *p, double *u, int with_adjoint, int *iterations) {
  int status;
  d_ocp_qp_set_b(0, p->first, &qp);
  d_ocp_qp_ipm_solve(&qp, &sol, &arg, &ws);
  d_ocp_qp_ipm_get_status(&ws, &status);
  d_ocp_qp_ipm_get_iter(&ws, iterations);
  for (int t = 0; t < p->N; ++t) d_ocp_qp_sol_get_u(t, &sol, u + t * p->nu);
  if (with_adjoint) d_ocp_qp_ipm_sens_adj(&qp, &seed, &sens, &arg, &ws);
  return status == 0;
}

static void set_sizes(const bounded_lqr *p) {
  d_ocp_qp_dim_create(p->N, &dim, malloc(d_ocp_qp_dim_memsize(p->N)));
  for (int t = 0; t <= p->N; ++t) {
    d_ocp_qp_dim_set_nx(t, t ? p->nx : 0, &dim);
    d_ocp_qp_dim_set_nu(t, t < p->N ? p->nu : 0, &dim);
    d_ocp_qp_dim_set_nbu(t, t < p->N ? p->nu : 0, &dim);
    d_ocp_qp_dim_set_nbx(t, 0, &dim);
    d_ocp_qp_dim_set_ng(t, 0, &dim);
    d_ocp_qp_dim_set_ns(t, 0, &dim);
  }
}

static void set_stages(const bounded_lqr *p) {
  d_ocp_qp_create(&dim, &qp, malloc(d_ocp_qp_memsize(&dim)));
  for (int t = 0; t <= p->N; ++t) {
    if (t < p->N) {
      if (t) d_ocp_qp_set_A(t, p->A, &qp);
      d_ocp_qp_set_B(t, p->B, &qp);
      d_ocp_qp_set_b(t, p->b, &qp);
      d_ocp_qp_set_R(t, p->R, &qp);
      d_ocp_qp_set_r(t, p->none, &qp);
      d_ocp_qp_set_idxbu(t, p->index, &qp);
      d_ocp_qp_set_lbu(t, p->low, &qp);
      d_ocp_qp_set_ubu(t, p->high, &qp);
    }
    if (t) {
      d_ocp_qp_set_Q(t, p->Q, &qp);
      d_ocp_qp_set_q(t, p->none, &qp);
    }
  }
}

int main(void) {
  bounded_lqr p = read_problems();
  set_sizes(&p);
  set_stages(&p);
  d_ocp_qp_sol_create(&dim, &sol, malloc(d_ocp_qp_sol_memsize(&dim)));
  d_ocp_qp_sol_create(&dim, &sens, malloc(d_ocp_qp_sol_memsize(&dim)));
  d_ocp_qp_seed_create(&dim, &seed, malloc(d_ocp_qp_seed_memsize(&dim)));
  d_ocp_qp_seed_set_zero(&seed);
  d_ocp_qp_seed_set_seed_r(0, p.one, &seed);
  d_ocp_qp_ipm_arg_create(&dim, &arg, malloc(d_ocp_qp_ipm_arg_memsize(&dim)));
  d_ocp_qp_ipm_arg_set_default(p.mode, &arg);
  int most = 200;
  d_ocp_qp_ipm_arg_set_iter_max(&most, &arg);
  d_ocp_qp_ipm_arg_set_tol_stat(&p.tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_eq(&p.tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_ineq(&p.tolerance, &arg);
  d_ocp_qp_ipm_arg_set_tol_comp(&p.tolerance, &arg);
  d_ocp_qp_ipm_ws_create(&dim, &arg, &ws, malloc(d_ocp_qp_ipm_ws_memsize(&dim, &arg)));
  return measure(&p, solve);
}
