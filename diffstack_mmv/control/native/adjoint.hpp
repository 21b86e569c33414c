// Derivatives of a solution by the implicit function theorem, as implicit.py has them.
#pragma once

namespace dmmv {

// what `dmmv_adjoint` is called with
struct Slopes {
  long count;
  const Real *parameters, *bounds, *x, *u;
  const bool* valid;
  const Real *g_x, *g_u, *g_cost;
  Real *g_parameters, *g_state;
};

template <class P>
struct Adjoint : Solver<P> {
  using Base = Solver<P>;
  using Base::n, Base::m, Base::T;
  using Base::A, Base::B, Base::H_xx, Base::H_ux, Base::H_uu, Base::costate, Base::q_step, Base::q_cost;

  Real k[T][m], K[T][m * n], V_x[T + 1][n], V_xx[T + 1][n * n];
  Real dx[T + 1][n], du[T + 1][m], dl[T][n];

  // roots of the diagonal of V_xx, the largest so far: what its rounding is measured by
  void extend(const Real* V, Real* extent) {
    for (int i = 0; i < n; ++i) extent[i] = op_max(extent[i], std::sqrt(std::fabs(V[i * n + i])));
  }

  // stationary point of the quadratic model with linear terms -g_x, -g_u; held and flat controls stay at zero
  void solve_free(const Real* g_x, const Real* g_u) {
    for (int i = 0; i < n; ++i) V_x[T][i] = -g_x[T * n + i];
    std::memcpy(V_xx[T], H_xx[T], sizeof(V_xx[T]));
    const Real eps = Real(FLAT * n) * std::numeric_limits<Real>::epsilon();
    Real extent[n] = {}, rounding[m];
    extend(V_xx[T], extent);
    for (int t = T - 1; t >= 0; --t) {
      Real VA[n * n], VB[n * m], ux[m * n], uu[m * m], Q_u[m], inverse[m * m], product_[m * n];
      bool is_free[m];
      for (int i = 0; i < n; ++i) V_x[t][i] = t ? -g_x[t * n + i] : Real(0);
      for (int i = 0; i < m; ++i) Q_u[i] = -g_u[t * m + i];
      std::memcpy(V_xx[t], H_xx[t], sizeof(V_xx[t]));
      std::memcpy(ux, H_ux[t], sizeof(ux));
      std::memcpy(uu, H_uu[t], sizeof(uu));
      add_transposed_apply<n, n>(A[t], V_x[t + 1], V_x[t]);
      add_transposed_apply<n, m>(B[t], V_x[t + 1], Q_u);
      product<n, n, n>(V_xx[t + 1], A[t], VA);
      product<n, n, m>(V_xx[t + 1], B[t], VB);
      add_transposed_product<n, n, n>(A[t], VA, V_xx[t]);
      add_transposed_product<n, m, n>(B[t], VA, ux);
      add_transposed_product<n, m, m>(B[t], VB, uu);
      make_symmetric<m>(uu);
      for (int i = 0; i < m; ++i) {
        Real reach = 0;
        for (int j = 0; j < n; ++j) reach += std::fabs(B[t][j * m + i]) * extent[j];
        rounding[i] = eps * (std::fabs(H_uu[t][i * m + i]) + reach * reach) + std::numeric_limits<Real>::min();
        is_free[i] = !this->held(t, i);
      }
      extend(V_xx[t], extent);
      regular_inverse<m>(uu, is_free, rounding, inverse);
      product<m, m, n>(inverse, ux, product_);
      for (int i = 0; i < m * n; ++i) K[t][i] = -product_[i];
      for (int i = 0; i < m; ++i) {
        k[t][i] = 0;
        for (int j = 0; j < m; ++j) k[t][i] -= inverse[i * m + j] * Q_u[j];
      }
      add_transposed_apply<m, n>(ux, k[t], V_x[t]);
      add_transposed_product<m, n, n>(ux, K[t], V_xx[t]);
      make_symmetric<n>(V_xx[t]);
    }
    std::memset(dx, 0, sizeof(dx));
    std::memset(du, 0, sizeof(du));
    for (int t = 0; t < T; ++t) {
      std::memcpy(du[t], k[t], sizeof(k[t]));
      add_product<m, n>(K[t], dx[t], du[t]);
      add_product<n, n>(A[t], dx[t], dx[t + 1]);
      add_product<n, m>(B[t], du[t], dx[t + 1]);
      std::memcpy(dl[t], V_x[t + 1], sizeof(dl[t]));
      add_product<n, n>(V_xx[t + 1], dx[t + 1], dl[t]);
    }
  }

  // weights of the numbers of the problem: -(d/dz of the gradient of the Lagrangian) dz + g_cost (its gradient)
  void weigh(Real g_cost, Real* w) {
    static thread_local Dual<Real> out[P::COST_NUMBERS + 1];
    for (int t = 0; t <= T; ++t) {
      Dual<Real> x[n], u[m];
      for (int i = 0; i < n; ++i) x[i] = {this->x[t][i], dx[t][i]};
      for (int i = 0; i < m; ++i) u[i] = {t < T ? this->u[t][i] : Real(0), du[t][i]};
      P::cost_numbers_gradient(t, x, u, q_cost[t], out);
      for (int i = 0; i < P::kind_numbers[P::cost_kind[t]]; ++i) w[P::cost_numbers[t][i]] += g_cost * out[i].v - out[i].d;
    }
    for (int first = 0; first < T; first += LANES) weigh_steps(first, g_cost, w);
  }

  // the same of the steps at eight times, one in each lane
  void weigh_steps(int first, Real g_cost, Real* w) {
    static thread_local Directed out[P::STEP_NUMBERS + 1];
    const int count = std::min(LANES, T - first);
    Directed x[n], u[m], l[n];
    for (int lane = 0; lane < LANES; ++lane) {
      const int t = first + (lane < count ? lane : 0);
      for (int i = 0; i < n; ++i) x[i].v[lane] = this->x[t][i], x[i].d[lane] = dx[t][i];
      for (int i = 0; i < m; ++i) u[i].v[lane] = this->u[t][i], u[i].d[lane] = du[t][i];
      for (int i = 0; i < n; ++i) l[i].v[lane] = costate[t][i], l[i].d[lane] = dl[t][i];
    }
    P::step_numbers_gradient(x, u, l, q_step, out);
    for (int i = 0; i < P::STEP_NUMBERS; ++i)
      for (int lane = 0; lane < count; ++lane) w[P::step_numbers[i]] += g_cost * out[i].v[lane] - out[i].d[lane];
  }

  // gradient of problem i
  void operator()(const Slopes& given, long i) {
    constexpr int rows = (T + 1) * n, entries = T * m;
    static thread_local std::vector<Real> weights(P::NUMBERS + 1);
    const Real* own = given.parameters + i * P::PARAMETERS;
    this->prepare(own, given.bounds);
    std::memcpy(this->x, given.x + i * rows, sizeof(Real) * rows);
    std::memcpy(this->u, given.u + i * entries, sizeof(Real) * entries);
    this->expand(true);
    solve_free(given.g_x + i * rows, given.g_u + i * entries);
    std::fill(weights.begin(), weights.end(), Real(0));
    weigh(given.g_cost[i], weights.data());
    P::prelude_adjoint(own, weights.data(), given.g_parameters + i * P::PARAMETERS);
    by_state(given.g_x + i * rows, given.g_cost[i], given.g_state + i * n);
  }

  void by_state(const Real* g_x, Real g_cost, Real* g_state) {
    Real slope[n];
    std::memcpy(slope, this->c_x[0], sizeof(slope));
    add_transposed_apply<n, n>(A[0], costate[0], slope);
    for (int i = 0; i < n; ++i) {
      Real change = 0;
      for (int j = 0; j < m; ++j) change += H_ux[0][j * n + i] * du[0][j];
      for (int j = 0; j < n; ++j) change += A[0][j * n + i] * dl[0][j];
      g_state[i] = g_x[i] + g_cost * slope[i] - change;
    }
  }
};

}  // namespace dmmv
