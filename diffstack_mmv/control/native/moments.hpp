// Gaussian controls through a model: mean and covariance of its states, to first order, and their adjoint.
//
// The generated `Problem` has the sizes n, m, and the functions of its step.
#pragma once
#include "abreast.hpp"
#include "stage.hpp"

namespace dmmv {

// weights that differ from lane to lane, times a number with slopes: the slope of lane i is along direction i
struct Weighted {
  Pack v, d;
};

inline Weighted operator+(const Weighted& a, const Weighted& b) { return {a.v + b.v, a.d + b.d}; }
inline Weighted operator+(const Weighted& a, const Pack& b) { return {a.v + b, a.d}; }
inline Weighted operator+(const Pack& a, const Weighted& b) { return {a + b.v, b.d}; }
inline Weighted operator-(const Weighted& a, const Weighted& b) { return {a.v - b.v, a.d - b.d}; }
inline Weighted operator-(const Weighted& a, const Pack& b) { return {a.v - b, a.d}; }
inline Weighted operator-(const Pack& a, const Weighted& b) { return {a - b.v, -b.d}; }
inline Weighted operator-(const Weighted& a) { return {-a.v, -a.d}; }
inline Weighted operator*(const Pack& a, const Dual<Pack>& b) { return {a * b.v, a * b.d}; }
inline Weighted operator*(const Dual<Pack>& a, const Pack& b) { return b * a; }
inline Weighted operator*(const Weighted& a, const Dual<Pack>& b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
inline Weighted operator*(const Dual<Pack>& a, const Weighted& b) { return b * a; }
inline Weighted operator*(const Weighted& a, Real b) { return {a.v * b, a.d * b}; }
inline Weighted operator*(Real a, const Weighted& b) { return b * a; }
inline Weighted operator/(const Weighted& a, Real b) { return a * (Real(1) / b); }
inline Weighted operator/(const Weighted& a, const Dual<Pack>& b) { return a * (Real(1) / b); }

inline Weighted to_weighted(const Weighted& a) { return a; }
inline Weighted to_weighted(const Pack& a) { return {a, Pack{}}; }
inline Weighted to_weighted(Real a) { return {Pack{} + a, Pack{}}; }
template <class A, class B>
inline Weighted either(bool c, const A& a, const B& b) {
  return c ? to_weighted(a) : to_weighted(b);
}

inline Real sum(const Pack& a) { return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7])); }
inline Real slopes(const Weighted& a) { return sum(a.d); }
inline Real slopes(const Pack&) { return 0; }
inline Real slopes(Real) { return 0; }

template <class P>
struct Moments {
  static constexpr int n = P::n, m = P::m, k = n + m;
  // kept of each step: state and covariance before it, Jacobian
  static constexpr int KEPT = n + n * n + n * k;

  // state after a step and its Jacobian (n, k)
  static void linearise(const Real* x, const Real* u, const Real* q, Real* y, Real* J) {
    std::memcpy(J, P::step_constant, sizeof(Real) * n * k);
    auto f = [&](const auto* x, const auto* u, auto* y) { P::step(x, u, q, y); };
    columns<n, m, n>(x, u, P::step_active, P::STEP_ACTIVE, f, y, J);
  }

  static void forward(long T, const Real* q, const Real* start, const Real* first, const Real* u, const Real* scale,
                      Real* mean, Real* covariance, Real* kept) {
    Real x[n], y[n], S[n * n], J[n * k], A[n * n], B[n * m], AS[n * n], D[n * m];
    std::memcpy(x, start, sizeof(x));
    std::memcpy(S, first, sizeof(S));
    for (long t = 0; t < T; ++t) {
      linearise(x, u + t * m, q, y, J);
      if (kept) {
        std::memcpy(kept + t * KEPT, x, sizeof(x));
        std::memcpy(kept + t * KEPT + n, S, sizeof(S));
        std::memcpy(kept + t * KEPT + n + n * n, J, sizeof(J));
      }
      split_jacobian<n, m>(J, A, B);
      product<n, n, n>(A, S, AS);
      product<n, m, m>(B, scale + t * m * m, D);
      for (int i = 0; i < n; ++i)
        for (int j = 0; j <= i; ++j) {
          Real s = 0;
          for (int l = 0; l < n; ++l) s += AS[i * n + l] * A[j * n + l];
          for (int l = 0; l < m; ++l) s += D[i * m + l] * D[j * m + l];
          S[i * n + j] = S[j * n + i] = s;
        }
      std::memcpy(x, y, sizeof(x));
      for (int i = 0; i < 2; ++i) {
        mean[t * 2 + i] = x[i];
        for (int j = 0; j < 2; ++j) covariance[t * 4 + i * 2 + j] = S[i * n + j];
      }
    }
  }

  // the second derivatives of a step times weights G (n, k) of its Jacobian, added to z (k) and to the numbers
  static void bend(const Real* x, const Real* u, const Real* q, const Real* G, Real* z, Real* numbers) {
    constexpr int K = P::STEP_ACTIVE;
    for (int first = 0; first < K; first += LANES) {
      Dual<Pack> at[k];
      Pack l[n] = {};
      for (int i = 0; i < n; ++i) at[i] = {x[i], Pack{}};
      for (int i = 0; i < m; ++i) at[n + i] = {u[i], Pack{}};
      for (int lane = 0; lane < (K - first < LANES ? K - first : LANES); ++lane) {
        const int column = P::step_active[first + lane];
        at[column].d[lane] = 1;
        for (int i = 0; i < n; ++i) l[i][lane] = G[i * k + column];
      }
      P::bend(at, at + n, l, q, z, numbers);
    }
  }

  static void backward(long T, const Real* q, const Real* u, const Real* scale, const Real* kept, const Real* g_mean,
                       const Real* g_covariance, Real* g_start, Real* g_first, Real* g_u, Real* g_scale, Real* numbers) {
    Real slope[n] = {}, W[n * n] = {};
    for (long t = T - 1; t >= 0; --t) {
      const Real *x = kept + t * KEPT, *S = x + n, *J = S + n * n, *L = scale + t * m * m;
      Real A[n * n], B[n * m], D[n * m], WA[n * n], G_A[n * n], G_D[n * m], G[n * k], z[k] = {};
      for (int i = 0; i < 2; ++i) {
        slope[i] += g_mean[t * 2 + i];
        for (int j = 0; j < 2; ++j)
          W[i * n + j] += Real(0.5) * (g_covariance[t * 4 + i * 2 + j] + g_covariance[t * 4 + j * 2 + i]);
      }
      split_jacobian<n, m>(J, A, B);
      product<n, m, m>(B, L, D);
      product<n, n, n>(W, A, WA);
      product<n, n, n>(WA, S, G_A);
      product<n, n, m>(W, D, G_D);
      std::memset(g_scale + t * m * m, 0, sizeof(Real) * m * m);
      add_transposed_product<n, m, m>(B, G_D, g_scale + t * m * m);
      for (int i = 0; i < m * m; ++i) g_scale[t * m * m + i] *= 2;
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) G[i * k + j] = 2 * G_A[i * n + j];
        for (int j = 0; j < m; ++j) {
          Real s = 0;
          for (int l = 0; l < m; ++l) s += G_D[i * m + l] * L[j * m + l];
          G[i * k + n + j] = 2 * s;
        }
      }
      for (int j = 0; j < k; ++j)
        for (int i = 0; i < n; ++i) z[j] += J[i * k + j] * slope[i];
      bend(x, u + t * m, q, G, z, numbers);
      P::weigh_numbers(x, u + t * m, slope, q, numbers);
      std::memcpy(slope, z, sizeof(slope));
      std::memcpy(g_u + t * m, z + n, sizeof(Real) * m);
      std::memset(W, 0, sizeof(W));
      add_transposed_product<n, n, n>(A, WA, W);
      make_symmetric<n>(W);
    }
    std::memcpy(g_start, slope, sizeof(slope));
    std::memcpy(g_first, W, sizeof(W));
  }
};

// whether slopes are zero throughout; what is no number is not
inline bool is_zero(const Real* slopes, long count) {
  for (long i = 0; i < count; ++i)
    if (slopes[i] != 0) return false;
  return true;
}

// of all rows; a template, so that what is not written for a step is not asked for
template <class P>
void moments_of_all(long count, long threads, long T, const Real* q, const Real* start, const Real* first,
                    const Real* u, const Real* scale, Real* mean, Real* covariance, Real* kept) {
  using M = Moments<P>;
  constexpr long abreast = P::ABREAST ? LANES : 1;
  for_each((count + abreast - 1) / abreast, threads, [=](long i) {
    if constexpr (P::ABREAST) {
      const Eight rows{i * abreast, int(std::min<long>(count - i * abreast, abreast))};
      Abreast<P>::forward(rows, T, q, start, first, u, scale, mean, covariance, kept);
    } else {
      M::forward(T, q, start + i * M::n, first + i * M::n * M::n, u + i * T * M::m, scale + i * T * M::m * M::m,
                 mean + i * T * 2, covariance + i * T * 4, kept ? kept + i * T * M::KEPT : nullptr);
    }
  });
}

// slopes of rows with these numbers; w holds a sum of the slopes of the step's numbers for each group of rows
template <class P>
void pull_all(const std::vector<long>& live, long threads, long T, const Real* q, const Real* u, const Real* scale,
              Real* kept, const Real* g_mean, const Real* g_covariance, Real* g_start, Real* g_first, Real* g_u,
              Real* g_scale, std::vector<Real>& w) {
  using M = Moments<P>;
  constexpr long abreast = P::ABREAST ? LANES : 1;
  const long found = long(live.size()), groups = (found + abreast - 1) / abreast;
  const long* rows = live.data();
  w.assign(P::LEARNS ? groups * (P::NUMBERS + 1) : P::NUMBERS + 1, Real(0));
  Real* each = w.data();
  for_each(groups, threads, [=](long g) {
    Real* own = P::LEARNS ? each + g * (P::NUMBERS + 1) : each;
    if constexpr (P::ABREAST) {
      const Eight eight{g * abreast, int(std::min<long>(found - g * abreast, abreast)), rows};
      Abreast<P>::backward(eight, T, q, u, scale, kept, g_mean, g_covariance, g_start, g_first, g_u, g_scale, own);
    } else {
      const long i = rows[g];
      M::backward(T, q, u + i * T * M::m, scale + i * T * M::m * M::m, kept + i * T * M::KEPT, g_mean + i * T * 2,
                  g_covariance + i * T * 4, g_start + i * M::n, g_first + i * M::n * M::n, g_u + i * T * M::m,
                  g_scale + i * T * M::m * M::m, own);
    }
  });
}

}  // namespace dmmv

#pragma GCC visibility push(default)
extern "C" {

// either function may be built by itself, so that both can be built side by side
#ifndef DMMV_ADJOINT_ALONE
// Moments of `count` roll-outs of T steps, row-major: parameters (PARAMETERS), start (count, n), covariance at the
// start (count, n, n), controls (count, T, m), Cholesky factors of their covariances (count, T, m, m) -> mean
// (count, T, 2), covariance (count, T, 2, 2), and what the adjoint reads (count, T, KEPT), where asked for.
void dmmv_moments(long count, long threads, long T, const Real* parameters, const Real* start, const Real* first,
                  const Real* u, const Real* scale, Real* mean, Real* covariance, Real* kept) {
  using P = Problem;
  Real q[P::NUMBERS + 1];
  P::prelude(parameters, q);
  dmmv::moments_of_all<P>(count, threads, T, q, start, first, u, scale, mean, covariance, kept);
}
#endif

#ifndef DMMV_MOMENTS_ALONE
// Gradient by all inputs for that by mean and covariance. Rows without one are left out.
void dmmv_moments_adjoint(long count, long threads, long T, const Real* parameters, const Real* u, const Real* scale,
                          Real* kept, const Real* g_mean, const Real* g_covariance, Real* g_parameters,
                          Real* g_start, Real* g_first, Real* g_u, Real* g_scale) {
  using P = Problem;
  using M = dmmv::Moments<P>;
  Real q[P::NUMBERS + 1];
  P::prelude(parameters, q);
  std::vector<long> live;
  for (long i = 0; i < count; ++i)
    if (dmmv::is_zero(g_mean + i * T * 2, T * 2) && dmmv::is_zero(g_covariance + i * T * 4, T * 4)) {
      std::fill_n(g_start + i * M::n, M::n, Real(0));
      std::fill_n(g_first + i * M::n * M::n, M::n * M::n, Real(0));
      std::fill_n(g_u + i * T * M::m, T * M::m, Real(0));
      std::fill_n(g_scale + i * T * M::m * M::m, T * M::m * M::m, Real(0));
    } else {
      live.push_back(i);
    }
  // one sum of the numbers' slopes per group of rows, added in order: the same with any number of threads
  std::vector<Real> w;
  dmmv::pull_all<P>(live, threads, T, q, u, scale, kept, g_mean, g_covariance, g_start, g_first, g_u, g_scale, w);
  if constexpr (P::LEARNS) {
    std::vector<Real> total(P::NUMBERS + 1);
    for (size_t g = 0; g < w.size(); g += P::NUMBERS + 1)
      for (int j = 0; j < P::NUMBERS; ++j) total[j] += w[g + j];
    P::prelude_adjoint(parameters, total.data(), g_parameters);
  }
}
#endif

}  // extern "C"
#pragma GCC visibility pop
