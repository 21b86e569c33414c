// Many rows side by side: a block of 64 rows of floats goes through all steps in the cache of a processor.
//
// Matrices are row-major. Inside of a block the rows come last, so that a vector holds one number of sixteen rows.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>
#include <vector>
#ifdef __SSE2__
#include <immintrin.h>
#endif

namespace {

typedef Real V __attribute__((vector_size(64)));
typedef std::conditional_t<sizeof(Real) == 4, int, long> Whole;
typedef Whole Wholes __attribute__((vector_size(64)));
constexpr int LANES = 64 / sizeof(Real), WIDE = 4, BLOCK = LANES * WIDE;

// numbers of a block: (units, WIDE)
typedef std::vector<V> Rows;

template <int N>
struct Taylor {
  Real factor[N + 1] = {1};
  constexpr Taylor() {
    for (int k = 1; k <= N; ++k) factor[k] = factor[k - 1] / k;
  }
};

inline V exponential(V x) {
  constexpr bool single = sizeof(Real) == 4;
  constexpr Real most = single ? 87 : 708, magic = single ? Real(12582912) : Real(6755399441055744);
  constexpr Real high = single ? Real(0.693359375) : Real(6.93147180369123816490e-01);
  constexpr Real low = single ? Real(-2.12194440e-4) : Real(1.90821492927058770002e-10);
  constexpr int terms = single ? 7 : 13, mantissa = single ? 23 : 52, bias = single ? 127 : 1023;
  x = x < -most ? V{} - most : x;
  x = x > most ? V{} + most : x;
  const V n = (x * Real(1.44269504088896340736) + magic) - magic;
  const V r = (x - n * high) - n * low;
  constexpr Taylor<terms> of;
  V p = V{} + of.factor[terms];
#pragma GCC unroll 16
  for (int k = terms - 1; k >= 0; --k) p = p * r + of.factor[k];
  const Wholes power = (__builtin_convertvector(n, Wholes) + bias) << mantissa;
  return p * V(power);
}
inline V reciprocal(V x) {
#ifdef __AVX512F__
  if constexpr (sizeof(Real) == 4) {  // a division takes four times as long
    const V guess = V(_mm512_rcp14_ps(__m512(x)));
    return guess * (2 - x * guess);
  }
#endif
  return 1 / x;
}
inline V sigmoid(V x) { return reciprocal(1 + exponential(-x)); }
inline V hyperbolic(V x) { return 2 * reciprocal(1 + exponential(-2 * x)) - 1; }

// out (N, M) = start (N, M) + A (N, K) X (K, M) in registers; M counts vectors, rows of X, start and out are `columns` apart
template <int N, int M>
inline void tile(const Real* A, long K, const V* X, long columns, const V* start, V* out) {
  V sum[N][M];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) sum[i][v] = start[i * columns + v];
  for (long k = 0; k < K; ++k)
#pragma GCC unroll 4
    for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
      for (int v = 0; v < M; ++v) sum[i][v] += A[i * K + k] * X[k * columns + v];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) out[i * columns + v] = sum[i][v];
}
template <int N>
inline void tiles(const Real* A, long K, const V* X, long columns, const V* start, V* out) {
  long v = 0;
  for (; v + 4 <= columns; v += 4) tile<N, 4>(A, K, X + v, columns, start + v, out + v);
  for (; v < columns; ++v) tile<N, 1>(A, K, X + v, columns, start + v, out + v);
}

// out (J, columns) = start + A (J, K) X (K, columns)
inline void product(const Real* A, long J, long K, const V* X, long columns, const V* start, V* out) {
  long j = 0;
  for (; j + 4 <= J; j += 4) tiles<4>(A + j * K, K, X, columns, start + j * columns, out + j * columns);
  for (; j < J; ++j) tiles<1>(A + j * K, K, X, columns, start + j * columns, out + j * columns);
}
inline void add_product(const Real* A, long J, long K, const V* X, long columns, V* out) {
  product(A, J, K, X, columns, out, out);
}

// out (J, columns) += products of J slopes with transposed inputs, over the rows of a block
inline void add_outer(const V* slopes, long J, const V* turned, long columns, V* out) {
  add_product(reinterpret_cast<const Real*>(slopes), J, BLOCK, turned, columns, out);
}

// the same for few inputs, (J, K), rows still to be summed up: each entry is a vector
inline void add_pairs(const V* slopes, long J, const V* X, long K, V* out) {
  for (long j = 0; j < J; ++j)
    for (long k = 0; k < K; ++k) {
      V sum = out[j * K + k];
      for (int w = 0; w < WIDE; ++w) sum += slopes[j * WIDE + w] * X[k * WIDE + w];
      out[j * K + k] = sum;
    }
}
inline Real total(V sums) {
  Real sum = 0;
  for (int lane = 0; lane < LANES; ++lane) sum += sums[lane];
  return sum;
}
inline void totals(const Rows& sums, Real* out) {
  for (const V& each : sums) *out++ = total(each);
}

// vectors that hold so many numbers
inline long vectors(long numbers) { return (numbers + LANES - 1) / LANES; }

inline V loaded(const Real* from) {
  V value;
  std::memcpy(&value, from, sizeof(V));
  return value;
}
inline void store(V value, Real* to) { std::memcpy(to, &value, sizeof(V)); }

// exchanges the entries (i, j + STEP) and (i + STEP, j) of a square of vectors, and so on with half the step
template <int STEP>
inline void transpose(V* square) {
  Wholes low, high;
  for (int lane = 0; lane < LANES; ++lane) {
    low[lane] = lane & STEP ? LANES + lane - STEP : lane;
    high[lane] = lane & STEP ? LANES + lane : lane + STEP;
  }
#pragma GCC unroll 16
  for (int i = 0; i < LANES; ++i)
    if (!(i & STEP)) {
      const V first = square[i], second = square[i + STEP];
      square[i] = __builtin_shuffle(first, second, low);
      square[i + STEP] = __builtin_shuffle(first, second, high);
    }
  if constexpr (STEP > 1) transpose<STEP / 2>(square);
}

// rows of a block, one after the other or by their numbers; `units` numbers of each stand `stride` apart
struct Block {
  long number, first, count;
  const long* rows = nullptr;

  long place(long row) const { return rows ? rows[first + row] : first + row; }

  // zeros fill up the block
  void take(const Real* from, long stride, long units, V* to) const {
    Real* entries = reinterpret_cast<Real*>(to);
    long unit = 0;
    for (; unit + LANES <= units; unit += LANES)
      for (int w = 0; w < WIDE; ++w) {
        V square[LANES];
        for (int r = 0; r < LANES; ++r) {
          const long row = w * LANES + r;
          square[r] = row < count ? loaded(from + place(row) * stride + unit) : V{};
        }
        transpose<LANES / 2>(square);
        for (int k = 0; k < LANES; ++k) to[(unit + k) * WIDE + w] = square[k];
      }
    for (; unit < units; ++unit)
      for (long row = 0; row < BLOCK; ++row)
        entries[unit * BLOCK + row] = row < count ? from[place(row) * stride + unit] : Real(0);
  }
  void give(const V* from, long units, Real* to, long stride) const {
    const Real* entries = reinterpret_cast<const Real*>(from);
    long unit = 0;
    for (; unit + LANES <= units; unit += LANES)
      for (int w = 0; w < WIDE && w * LANES < count; ++w) {
        V square[LANES];
        for (int k = 0; k < LANES; ++k) square[k] = from[(unit + k) * WIDE + w];
        transpose<LANES / 2>(square);
        for (long r = 0; r < LANES && w * LANES + r < count; ++r)
          store(square[r], to + place(w * LANES + r) * stride + unit);
      }
    for (; unit < units; ++unit)
      for (long row = 0; row < count; ++row) to[place(row) * stride + unit] = entries[unit * BLOCK + row];
  }
};

// units with the rows last as rows of units, and back; whole vectors of both
inline void turn(const V* from, long units, V* to, long width) {
  Block{0, 0, BLOCK}.give(from, units, reinterpret_cast<Real*>(to), width * LANES);
}
inline void turn_back(const V* from, long width, long units, V* to) {
  Block{0, 0, BLOCK}.take(reinterpret_cast<const Real*>(from), width * LANES, units, to);
}

inline long blocks_of(long rows) { return (rows + BLOCK - 1) / BLOCK; }

// f(block) for all rows, or those with these numbers
template <class F>
inline void each_block(long count, long threads, F f, const long* rows = nullptr) {
  dmmv::for_each(blocks_of(count), threads, [&](long i) {
    f(Block{i, i * BLOCK, std::min<long>(count - i * BLOCK, BLOCK), rows});
  });
}

}  // namespace
