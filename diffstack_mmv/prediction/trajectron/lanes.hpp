// Many rows side by side: a block of 64 rows of floats goes through all steps in the cache of a processor.
//
// Matrices are row-major. Inside of a block the rows come last, so that a vector holds one number of several rows: as
// many as a register of the processor. A compiler takes wider ones apart in memory, which takes more than ten times as long.
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

#if defined(__AVX512F__)
constexpr int BYTES = 64, SUMS = 4;
#elif defined(__AVX__)
constexpr int BYTES = 32, SUMS = 2;
#else
constexpr int BYTES = 16, SUMS = 2;
#endif
typedef Real V __attribute__((vector_size(BYTES)));
typedef std::conditional_t<sizeof(Real) == 4, int, long> Whole;
typedef Whole Wholes __attribute__((vector_size(BYTES)));
constexpr int LANES = BYTES / sizeof(Real), WIDE = 256 / BYTES, BLOCK = LANES * WIDE;
constexpr int FEW = 4;  // numbers that are faster moved one by one than turned as a square

// numbers of a block: (units, WIDE)
typedef std::vector<V> Rows;

template <int N>
struct Taylor {
  Real factor[N + 1] = {1};
  constexpr Taylor() {
    for (int k = 1; k <= N; ++k) factor[k] = factor[k - 1] / k;
  }
};

// x within a limit to both sides; what is no number is passed on
inline V within(Real limit, V x) {
#ifdef __AVX512F__
  if constexpr (sizeof(Real) == 4) {
    const __m512 most = __m512(V{} + limit), least = __m512(V{} - limit);
    return V(_mm512_min_ps(most, _mm512_max_ps(least, __m512(x))));
  }
#endif
  x = x < -limit ? V{} - limit : x;
  return x > limit ? V{} + limit : x;
}
// p 2^n for whole n
inline V scaled(V p, V n) {
#ifdef __AVX512F__
  if constexpr (sizeof(Real) == 4) return V(_mm512_scalef_ps(__m512(p), __m512(n)));
#endif
  constexpr int mantissa = sizeof(Real) == 4 ? 23 : 52, bias = sizeof(Real) == 4 ? 127 : 1023;
  const Wholes power = (__builtin_convertvector(n, Wholes) + bias) << mantissa;
  return p * V(power);
}

inline V exponential(V x) {
  constexpr bool single = sizeof(Real) == 4;
  constexpr Real most = single ? 87 : 708, magic = single ? Real(12582912) : Real(6755399441055744);
  constexpr Real high = single ? Real(0.693359375) : Real(6.93147180369123816490e-01);
  constexpr Real low = single ? Real(-2.12194440e-4) : Real(1.90821492927058770002e-10);
  constexpr int terms = single ? 7 : 13;
  x = within(most, x);
  const V n = (x * Real(1.44269504088896340736) + magic) - magic;
  const V r = (x - n * high) - n * low;
  constexpr Taylor<terms> of;
  V p = V{} + of.factor[terms];
#pragma GCC unroll 16
  for (int k = terms - 1; k >= 0; --k) p = p * r + of.factor[k];
  return scaled(p, n);
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
#pragma GCC unroll 6
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) sum[i][v] = start[i * columns + v];
  for (long k = 0; k < K; ++k)
#pragma GCC unroll 6
    for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
      for (int v = 0; v < M; ++v) sum[i][v] += A[i * K + k] * X[k * columns + v];
#pragma GCC unroll 6
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) out[i * columns + v] = sum[i][v];
}
template <int N>
inline void tiles(const Real* A, long K, const V* X, long columns, const V* start, V* out) {
  long v = 0;
  for (; v + SUMS <= columns; v += SUMS) tile<N, SUMS>(A, K, X + v, columns, start + v, out + v);
  const auto rest = [&](auto count) { tile<N, count>(A, K, X + v, columns, start + v, out + v); };
  if constexpr (SUMS > 2) {
    if (columns - v == 3) rest(std::integral_constant<int, 3>{});
    if (columns - v == 2) rest(std::integral_constant<int, 2>{});
  }
  if (columns - v == 1) rest(std::integral_constant<int, 1>{});
}

// out (J, columns) = start + A (J, K) X (K, columns)
inline void product(const Real* A, long J, long K, const V* X, long columns, const V* start, V* out) {
  long j = 0;
  const auto some = [&](auto count) {
    tiles<count>(A + j * K, K, X, columns, start + j * columns, out + j * columns);
    j += count;
  };
  while ((J - j) % 6 && J - j >= 4) some(std::integral_constant<int, 4>{});
  while (J - j >= 6) some(std::integral_constant<int, 6>{});  // 24 of 32 registers for sums, or 12 of 16
  while (j < J) some(std::integral_constant<int, 1>{});
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
// the first numbers of a vector, zeros behind them
inline V loaded(const Real* from, long count) {
#ifdef __AVX512F__
  return V(_mm512_maskz_loadu_ps(__mmask16((1 << count * sizeof(Real) / sizeof(float)) - 1), from));
#else
  V value{};
  for (long lane = 0; lane < count; ++lane) value[lane] = from[lane];
  return value;
#endif
}
inline void store(V value, Real* to) { std::memcpy(to, &value, sizeof(V)); }
// past the caches, to where whole vectors stand: for what is read much later
inline void stream(V value, Real* to) {
#ifdef __AVX512F__
  _mm512_stream_ps(reinterpret_cast<float*>(to), __m512(value));
#else
  store(value, to);
#endif
}
// asks for numbers that are read soon
inline void announce(const Real* from, long count) {
  for (long i = 0; i < count; i += LANES) __builtin_prefetch(from + i, 0, 2);
}

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
    for (; unit + LANES <= units; unit += LANES) take_square<true>(from + unit, stride, LANES, to + unit * WIDE);
    if (units - unit > FEW) return take_square<false>(from + unit, stride, units - unit, to + unit * WIDE);
    for (; unit < units; ++unit)
      for (long row = 0; row < BLOCK; ++row)
        entries[unit * BLOCK + row] = row < count ? from[place(row) * stride + unit] : Real(0);
  }
  template <bool WHOLE>
  void take_square(const Real* from, long stride, long units, V* to) const {
    for (int w = 0; w < WIDE; ++w) {
      V square[LANES];
      for (int r = 0; r < LANES; ++r) {
        const long row = w * LANES + r;
        square[r] = V{};
        if (row >= count) continue;  // it has no place
        const Real* own = from + place(row) * stride;
        square[r] = WHOLE ? loaded(own) : loaded(own, units);
      }
      transpose<LANES / 2>(square);
      for (int k = 0; k < (WHOLE ? LANES : units); ++k) to[k * WIDE + w] = square[k];
    }
  }
  template <void put(V, Real*) = store>
  void give(const V* from, long units, Real* to, long stride) const {
    const Real* entries = reinterpret_cast<const Real*>(from);
    long unit = 0;
    for (; unit + LANES <= units; unit += LANES)
      for (int w = 0; w < WIDE && w * LANES < count; ++w) {
        V square[LANES];
        for (int k = 0; k < LANES; ++k) square[k] = from[(unit + k) * WIDE + w];
        transpose<LANES / 2>(square);
        for (long r = 0; r < LANES && w * LANES + r < count; ++r)
          put(square[r], to + place(w * LANES + r) * stride + unit);
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

#pragma GCC visibility push(default)
extern "C" {

// Numbers of a vector, which rows of units that are kept are filled up to.
long dmmv_lanes() { return LANES; }

}  // extern "C"
#pragma GCC visibility pop
