// Eight linear-quadratic problems side by side, one in each lane.
#pragma once
#include "stage.hpp"

namespace dmmv {

// C += A B,  B (k, b), C (a, b); entry (i, k) of A stands at A[i * SI + k * SK]; if SYMMETRIC C is its own transpose
template <int A_, int K, int B_, int SI, int SK, bool SYMMETRIC = false>
inline void lane_product(const Pack* A, const Pack* B, Pack* C) {
  for (int i = 0; i < A_; ++i) {
    int j = SYMMETRIC ? i / 4 * 4 : 0;
    for (; j + 4 <= B_; j += 4) {
      Pack *to = C + i * B_ + j, c0 = to[0], c1 = to[1], c2 = to[2], c3 = to[3];
      for (int k = 0; k < K; ++k) {
        const Pack a = A[i * SI + k * SK], *b = B + k * B_ + j;
        c0 += a * b[0];
        c1 += a * b[1];
        c2 += a * b[2];
        c3 += a * b[3];
      }
      to[0] = c0, to[1] = c1, to[2] = c2, to[3] = c3;
    }
    for (; j < B_; ++j) {
      Pack c = C[i * B_ + j];
      for (int k = 0; k < K; ++k) c += A[i * SI + k * SK] * B[k * B_ + j];
      C[i * B_ + j] = c;
    }
  }
  if constexpr (SYMMETRIC)
    for (int i = 0; i < A_; ++i)
      for (int j = 0; j < i; ++j) C[i * B_ + j] = C[j * B_ + i];
}

// y += A x,  A (a, b)
template <int A_, int B_>
inline void lane_apply(const Pack* A, const Pack* x, Pack* y) {
  lane_product<A_, B_, 1, B_, 1>(A, x, y);
}

// y += A' x,  A (a, b)
template <int A_, int B_>
inline void lane_transposed_apply(const Pack* A, const Pack* x, Pack* y) {
  for (int i = 0; i < A_; ++i)
    for (int j = 0; j < B_; ++j) y[j] += A[i * B_ + j] * x[i];
}

inline Pack least(const Pack& a, const Pack& b) { return a < b ? a : b; }
inline Pack most(const Pack& a, const Pack& b) { return a > b ? a : b; }
inline Pack magnitude(const Pack& a) { return a < Pack{} ? -a : a; }
inline Pack between(const Pack& a, Real low, Real high) { return least(most(a, Pack{} + low), Pack{} + high); }
inline bool any(const Mask& a) {
  bool found = false;
  for (int lane = 0; lane < LANES; ++lane) found = found || a[lane];
  return found;
}

// inverse of the free rows and columns (`is_free` one or zero), zero elsewhere; the smallest pivot
template <int M>
inline Pack lane_inverse(const Pack* H, const Pack* is_free, Pack* inverse) {
  Pack L[M][M], W[M][M], scale[M], worst = Pack{} + std::numeric_limits<Real>::max();
  for (int j = 0; j < M; ++j) {
    Pack pivot = is_free[j] * H[j * M + j] + (1 - is_free[j]);
    for (int k = 0; k < j; ++k) pivot -= L[j][k] * L[j][k] * scale[k];
    worst = pivot > Pack{} ? least(worst, pivot) : Pack{} - 1;
    scale[j] = 1 / pivot;  // of L that is not divided by its pivots
    for (int i = j + 1; i < M; ++i) {
      L[i][j] = is_free[i] * is_free[j] * H[i * M + j];
      for (int k = 0; k < j; ++k) L[i][j] -= L[i][k] * L[j][k] * scale[k];
    }
  }
  for (int j = 0; j < M; ++j)
    for (int i = j; i < M; ++i) {
      W[i][j] = i == j ? Pack{} + 1 : Pack{};
      for (int k = j; k < i; ++k) W[i][j] -= L[i][k] * scale[k] * W[k][j];
    }
  for (int i = 0; i < M; ++i)
    for (int j = 0; j <= i; ++j) {
      Pack sum = {};
      for (int k = i; k < M; ++k) sum += W[k][i] * W[k][j] * scale[k];
      inverse[i * M + j] = inverse[j * M + i] = is_free[i] * is_free[j] * sum;
    }
  return worst;
}

// x+ = A x + B u + c, costs ½ (x, u)' H (x, u) + g'(x, u) + a constant, of one problem, with its numbers
template <class P>
struct LinearModel {
  static constexpr int n = P::n, m = P::m, T = P::T;
  Real numbers[P::NUMBERS + 1], q_step[P::STEP_NUMBERS + 1], q_cost[T + 1][P::COST_NUMBERS + 1];
  Real A[n * n], B[n * m], c[n];
  Real H_xx[T + 1][n * n], H_ux[T + 1][m * n], H_uu[T + 1][m * m], g_x[T + 1][n], g_u[T + 1][m];
  bool is_known = false;

  // whether it is another one than before
  bool load(const Real* parameters) {
    Real before[P::NUMBERS + 1];
    if (is_known) std::memcpy(before, numbers, sizeof(before));
    P::prelude(parameters, numbers);
    if (is_known && std::memcmp(before, numbers, sizeof(Real) * P::NUMBERS) == 0) return false;
    const Real x[n] = {}, u[m] = {};
    for (int i = 0; i < P::STEP_NUMBERS; ++i) q_step[i] = numbers[P::step_numbers[i]];
    step_jacobian<P>(x, u, q_step, A, B);
    P::step(x, u, q_step, c);
    for (int t = 0; t <= T; ++t) {
      if (P::cost_alike[t] != t) continue;
      for (int i = 0; i < P::COST_NUMBERS; ++i) q_cost[t][i] = numbers[P::cost_numbers[t][i]];
      cost_model<P>(t, x, u, q_cost[t], g_x[t], g_u[t], H_xx[t], H_ux[t], H_uu[t]);
    }
    return is_known = true;
  }
};

// numbers of all lanes are kept by each thread, so that long horizons of many states are left to the iterations
constexpr size_t MOST_BYTES = 32u << 20;
template <class P>
constexpr bool fits_lanes = sizeof(Pack) * (P::T + 1) * (P::n + P::m) * (P::n + P::m) * 4 < MOST_BYTES;

// the same of eight problems
template <class P>
struct LaneModel {
  static constexpr int n = P::n, m = P::m, T = P::T;
  Pack A[n * n], B[n * m], c[n];
  Pack H_xx[T + 1][n * n], H_ux[T + 1][m * n], H_uu[T + 1][m * m], g_x[T + 1][n], g_u[T + 1][m];
  long versions[LANES] = {}, version = 0;
  LinearModel<P> one;

  // `one` becomes the problem with these parameters
  void fetch(const Real* parameters) {
    if (one.load(parameters)) ++version;
  }

  // whether a lane gets another problem than it has
  bool load(int lane, const Real* parameters) {
    fetch(parameters);
    if (versions[lane] == version) return false;
    versions[lane] = version;
    put(lane, one.A, A, n * n);
    put(lane, one.B, B, n * m);
    put(lane, one.c, c, n);
    for (int t = 0; t <= T; ++t) {
      if (P::cost_alike[t] != t) continue;
      put(lane, one.H_xx[t], H_xx[t], n * n);
      put(lane, one.H_ux[t], H_ux[t], m * n);
      put(lane, one.H_uu[t], H_uu[t], m * m);
      put(lane, one.g_x[t], g_x[t], n);
      put(lane, one.g_u[t], g_u[t], m);
    }
    return true;
  }

  static void put(int lane, const Real* from, Pack* to, int count) {
    for (int i = 0; i < count; ++i) to[i][lane] = from[i];
  }
};

}  // namespace dmmv
