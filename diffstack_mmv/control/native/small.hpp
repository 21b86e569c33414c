// Products of small matrices, and small quadratic programs in a box; row-major arrays of known size.
#pragma once
#include "numbers.hpp"

namespace dmmv {

constexpr Real DEFINITE = Real(1e-6), FLAT = 16;

inline bool finite(Real a) { return std::isfinite(a); }
inline Real clipped(Real a, Real low, Real high) {
  a = a < low ? low : a;
  return a > high ? high : a;
}

// C += A' B,  A (k, a), B (k, b)
template <int K, int A_, int B_>
inline void add_transposed_product(const Real* A, const Real* B, Real* C) {
  for (int k = 0; k < K; ++k)
    for (int i = 0; i < A_; ++i)
      for (int j = 0; j < B_; ++j) C[i * B_ + j] += A[k * A_ + i] * B[k * B_ + j];
}

// C = A B,  A (a, k), B (k, b)
template <int A_, int K, int B_>
inline void product(const Real* A, const Real* B, Real* C) {
  for (int i = 0; i < A_; ++i) {
    for (int j = 0; j < B_; ++j) C[i * B_ + j] = 0;
    for (int k = 0; k < K; ++k)
      for (int j = 0; j < B_; ++j) C[i * B_ + j] += A[i * K + k] * B[k * B_ + j];
  }
}

template <int A_, int B_>
inline void add_product(const Real* A, const Real* x, Real* y) {
  for (int i = 0; i < A_; ++i) {
    Real sum = 0;
    for (int j = 0; j < B_; ++j) sum += A[i * B_ + j] * x[j];
    y[i] += sum;
  }
}

template <int A_, int B_>
inline void add_transposed_apply(const Real* A, const Real* x, Real* y) {
  for (int i = 0; i < A_; ++i)
    for (int j = 0; j < B_; ++j) y[j] += A[i * B_ + j] * x[i];
}

template <int K>
inline void make_symmetric(Real* A) {
  for (int i = 0; i < K; ++i)
    for (int j = 0; j < i; ++j) A[i * K + j] = A[j * K + i] = Real(0.5) * (A[i * K + j] + A[j * K + i]);
}

template <int M>
inline Real largest(const Real* Q) {
  Real most = 0;
  for (int i = 0; i < M * M; ++i) most = Q[i] != Q[i] ? Q[i] : op_max(most, std::fabs(Q[i]));
  return most;
}

// raises the diagonal of H by a share of what it lacks to dominate its rows, `outside` being the rest of each row
template <int K>
inline void add_dominance(Real* H, const Real* outside, Real share) {
  for (int i = 0; i < K; ++i) {
    Real row = outside ? outside[i] : Real(0);
    for (int j = 0; j < K; ++j) row += j == i ? Real(0) : std::fabs(H[i * K + j]);
    const Real lack = row - H[i * K + i];
    if (lack > 0) H[i * K + i] += share * lack;
  }
}

// a pivot that is at least `floor`, else its modulus, or `floor` where that is larger
inline Real upright(Real pivot, Real floor) { return pivot < floor ? op_max(std::fabs(pivot), floor) : pivot; }

// what to add to the diagonal of a symmetric Q to make it positive definite, see `positive_lift` of box_qp.py
template <int M>
inline void positive_lift(const Real* Q, Real* lift) {
  const Real tiny = std::numeric_limits<Real>::min(), scale = largest<M>(Q);
  Real floor[M];
  for (int i = 0; i < M; ++i) floor[i] = DEFINITE * op_max(std::fabs(Q[i * M + i]), DEFINITE * scale) + tiny;
  if constexpr (M == 1) {
    lift[0] = upright(Q[0], floor[0]) - Q[0];
  } else if constexpr (M == 2) {
    const int first = Q[0] >= Q[3] ? 0 : 1, second = 1 - first;
    const Real pivot = Q[3 * first], other = Q[3 * second], square = Q[1] * Q[1];
    const Real raised = op_max(upright(pivot, floor[first]), square / (scale + tiny)), rest = other - square / raised;
    lift[first] = raised - pivot;
    lift[second] = upright(rest, floor[second]) - rest;
  } else {
    Real S[M * M];
    bool left[M];
    std::memcpy(S, Q, sizeof(S));
    for (int i = 0; i < M; ++i) left[i] = true;
    for (int step = 0; step < M; ++step) {
      int j = 0;
      while (!left[j]) ++j;
      for (int i = j + 1; i < M; ++i)
        if (left[i] && S[i * M + i] > S[j * M + j]) j = i;
      left[j] = false;
      Real beside = 0;
      for (int i = 0; i < M; ++i)
        if (left[i]) beside = op_max(beside, S[i * M + j] * S[i * M + j]);
      const Real pivot = S[j * M + j], raised = op_max(upright(pivot, floor[j]), beside / (scale + tiny));
      lift[j] = raised - pivot;
      for (int i = 0; i < M; ++i)
        for (int k = 0; k < M; ++k)
          if (left[i] && left[k]) S[i * M + k] -= S[i * M + j] * S[k * M + j] / raised;
    }
  }
}

// inverse of the free rows and columns, zero elsewhere
template <int M>
inline void free_inverse(const Real* H, const bool* is_free, Real* inverse) {
  for (int i = 0; i < M * M; ++i) inverse[i] = 0;
  if constexpr (M == 1) {
    if (is_free[0]) inverse[0] = 1 / H[0];
  } else if constexpr (M == 2) {
    if (is_free[0] && is_free[1]) {
      const Real determinant = H[0] * H[3] - H[1] * H[1];
      inverse[0] = H[3] / determinant;
      inverse[3] = H[0] / determinant;
      inverse[1] = inverse[2] = -H[1] / determinant;
    } else if (is_free[0]) {
      inverse[0] = 1 / H[0];
    } else if (is_free[1]) {
      inverse[3] = 1 / H[3];
    }
  } else {
    int index[M], k = 0;
    for (int i = 0; i < M; ++i)
      if (is_free[i]) index[k++] = i;
    Real A[M][2 * M];
    for (int i = 0; i < k; ++i)
      for (int j = 0; j < k; ++j) {
        A[i][j] = H[index[i] * M + index[j]];
        A[i][k + j] = i == j;
      }
    for (int c = 0; c < k; ++c) {
      int pivot = c;
      for (int i = c + 1; i < k; ++i)
        if (std::fabs(A[i][c]) > std::fabs(A[pivot][c])) pivot = i;
      for (int j = 0; j < 2 * k; ++j) std::swap(A[c][j], A[pivot][j]);
      const Real scale = 1 / A[c][c];
      for (int j = 0; j < 2 * k; ++j) A[c][j] *= scale;
      for (int i = 0; i < k; ++i) {
        const Real factor = A[i][c];
        if (i == c || factor == 0) continue;
        for (int j = 0; j < 2 * k; ++j) A[i][j] -= factor * A[c][j];
      }
    }
    for (int i = 0; i < k; ++i)
      for (int j = 0; j < k; ++j) inverse[index[i] * M + index[j]] = A[i][k + j];
  }
}

// inverse of as many free rows and columns as have one, zero elsewhere, see `regular_inverse` of box_qp.py
template <int M>
inline void regular_inverse(const Real* H, const bool* is_free, const Real* noise, Real* inverse) {
  Real S[M][M];
  bool left[M], swept[M] = {};
  for (int i = 0; i < M; ++i) {
    left[i] = is_free[i];
    for (int j = 0; j < M; ++j) S[i][j] = is_free[i] && is_free[j] ? H[i * M + j] : Real(0);
  }
  for (;;) {
    int c = -1;
    Real size = 1;
    for (int i = 0; i < M; ++i)
      if (left[i] && std::fabs(S[i][i]) / noise[i] > size) size = std::fabs(S[i][i]) / noise[i], c = i;
    if (c < 0) break;
    left[c] = false;
    swept[c] = true;
    const Real pivot = S[c][c];
    for (int i = 0; i < M; ++i)
      for (int j = 0; j < M; ++j)
        if (i != c && j != c) S[i][j] -= S[i][c] * S[c][j] / pivot;
    for (int i = 0; i < M; ++i)
      if (i != c) S[i][c] = S[c][i] = S[c][i] / pivot;
    S[c][c] = -1 / pivot;
  }
  for (int i = 0; i < M; ++i)
    for (int j = 0; j < M; ++j) inverse[i * M + j] = swept[i] && swept[j] ? -S[i][j] : Real(0);
}

// the inverse of a positive definite matrix, faster; false if it is not definite
template <int M>
inline bool definite_inverse(const Real* H, const bool* is_free, Real* inverse) {
  Real L[M][M], W[M][M], pivot[M];
  for (int j = 0; j < M; ++j) {
    pivot[j] = is_free[j] ? H[j * M + j] : Real(1);
    for (int k = 0; k < j; ++k) pivot[j] -= L[j][k] * L[j][k] * pivot[k];
    if (!(pivot[j] > 0)) return false;
    const Real scale = 1 / pivot[j];
    for (int i = j + 1; i < M; ++i) {
      Real sum = is_free[i] && is_free[j] ? H[i * M + j] : Real(0);
      for (int k = 0; k < j; ++k) sum -= L[i][k] * L[j][k] * pivot[k];
      L[i][j] = sum * scale;
    }
  }
  for (int j = 0; j < M; ++j)
    for (int i = j; i < M; ++i) {  // W = inverse of L
      Real sum = i == j;
      for (int k = j; k < i; ++k) sum -= L[i][k] * W[k][j];
      W[i][j] = sum;
    }
  for (int i = 0; i < M; ++i)
    for (int j = 0; j <= i; ++j) {
      Real sum = 0;
      for (int k = i; k < M; ++k) sum += W[k][i] * W[k][j] / pivot[k];
      inverse[i * M + j] = inverse[j * M + i] = is_free[i] && is_free[j] ? sum : Real(0);
    }
  return true;
}

inline void edge(Real k0, Real k1, const Real* H, const Real* g, Real* best, Real& value) {
  const Real v = k0 * (Real(0.5) * H[0] * k0 + H[1] * k1 + g[0]) + k1 * (Real(0.5) * H[3] * k1 + g[1]);
  if (v < value) {
    value = v;
    best[0] = k0;
    best[1] = k1;
  }
}

// the unconstrained minimiser if it lies inside, else the best of the four edges
inline void box_qp_of_pair(const Real* H, const Real* g, const Real* low, const Real* high, Real* k) {
  const Real a = H[0], b = H[1], c = H[3], determinant = a * c - b * b;
  k[0] = (b * g[1] - c * g[0]) / determinant;
  k[1] = (b * g[0] - a * g[1]) / determinant;
  if (k[0] >= low[0] && k[0] <= high[0] && k[1] >= low[1] && k[1] <= high[1]) return;
  Real best[2], value = 0;
  auto second = [&](Real k0) { return clipped(-(g[1] + b * k0) / c, low[1], high[1]); };
  auto first = [&](Real k1) { return clipped(-(g[0] + b * k1) / a, low[0], high[0]); };
  best[0] = low[0];
  best[1] = second(low[0]);
  value = best[0] * (Real(0.5) * a * best[0] + b * best[1] + g[0]) + best[1] * (Real(0.5) * c * best[1] + g[1]);
  edge(high[0], second(high[0]), H, g, best, value);
  edge(first(low[1]), low[1], H, g, best, value);
  edge(first(high[1]), high[1], H, g, best, value);
  k[0] = best[0];
  k[1] = best[1];
}

// block principal pivoting, as in box_qp.py
template <int M>
inline void box_qp_by_pivoting(const Real* H, const Real* g, const Real* low, const Real* high, Real* k) {
  int side[M], fewest = M + 1;
  bool patient = true, is_free[M];
  Real inverse[M * M], fixed[M], rest[M];
  for (int i = 0; i < M; ++i) side[i] = low[i] >= high[i] ? -1 : 0;  // what has no choice is never free
  for (int exchange = 0; exchange < 200; ++exchange) {
    for (int i = 0; i < M; ++i) {
      is_free[i] = side[i] == 0;
      fixed[i] = side[i] < 0 ? low[i] : side[i] > 0 ? high[i] : Real(0);
      rest[i] = g[i];
    }
    if (!definite_inverse<M>(H, is_free, inverse)) free_inverse<M>(H, is_free, inverse);
    add_product<M, M>(H, fixed, rest);
    for (int i = 0; i < M; ++i) {
      k[i] = fixed[i];
      if (is_free[i])
        for (int j = 0; j < M; ++j) k[i] -= inverse[i * M + j] * rest[j];
    }
    int number = 0, last = 0, wanted[M];
    for (int i = 0; i < M; ++i) {
      Real slope = g[i];
      for (int j = 0; j < M; ++j) slope += H[i * M + j] * k[j];
      wanted[i] = is_free[i] ? (k[i] < low[i] ? -1 : k[i] > high[i] ? 1 : 0) : (side[i] * slope > 0 && low[i] < high[i] ? 0 : side[i]);
      if (wanted[i] != side[i]) {
        ++number;
        last = i;
      }
    }
    if (number == 0) break;
    const bool fewer = number < fewest;
    for (int i = 0; i < M; ++i)
      if (fewer || patient || i == last) side[i] = wanted[i];
    fewest = fewer ? number : fewest;
    patient = fewer;
  }
  for (int i = 0; i < M; ++i) k[i] = clipped(k[i], low[i], high[i]);
}

template <int M>
inline void solve_box_qp(const Real* H, const Real* g, const Real* low, const Real* high, Real* k, bool* is_free) {
  if constexpr (M == 1)
    k[0] = clipped(-g[0] / H[0], low[0], high[0]);
  else if constexpr (M == 2)
    box_qp_of_pair(H, g, low, high, k);
  else
    box_qp_by_pivoting<M>(H, g, low, high, k);
  for (int i = 0; i < M; ++i) is_free[i] = k[i] > low[i] && k[i] < high[i];
}

}  // namespace dmmv
