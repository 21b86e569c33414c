// Recurrences over many rows: 64 rows of floats side by side take all steps in the cache of a processor.
//
// Matrices are row-major. States are kept for the backward pass with the rows last, (steps, units, padded), where the
// rows are filled up with zeros to whole blocks; the gates are computed again. Slopes of weights are one matrix per
// block, to be summed in the order of the blocks: the same with any number of threads.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <thread>
#include <type_traits>
#include <vector>
#ifdef __SSE2__
#include <immintrin.h>
#endif

namespace {

// While one lives, numbers too small to be normal count as zero: slopes fade to them step by step, and a processor takes
// a hundred times as long for each.
struct NormalOnly {
#ifdef __SSE2__
  unsigned before = _mm_getcsr();
  NormalOnly() { _mm_setcsr(before | 0x8040); }
  ~NormalOnly() { _mm_setcsr(before); }
#endif
};

typedef Real V __attribute__((vector_size(64)));
typedef std::conditional_t<sizeof(Real) == 4, int, long> Whole;
typedef Whole Wholes __attribute__((vector_size(64)));
constexpr int LANES = 64 / sizeof(Real), WIDE = 4, BLOCK = LANES * WIDE;

// a number per row of a block, and some of them
typedef V Row[WIDE];
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

// out += W in, for N rows of W
template <int N>
inline void some(const Real* W, long stride, long K, const V* in, V* out) {
  V sum[N][WIDE];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int w = 0; w < WIDE; ++w) sum[i][w] = out[i * WIDE + w];
  for (long k = 0; k < K; ++k)
#pragma GCC unroll 4
    for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
      for (int w = 0; w < WIDE; ++w) sum[i][w] += W[i * stride + k] * in[k * WIDE + w];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int w = 0; w < WIDE; ++w) out[i * WIDE + w] = sum[i][w];
}

// out (N, M vectors of `width`) += sum over rows of G (N) times X (rows, width)
template <int N, int M>
inline void tile(const Real* G, const V* X, long width, V* out) {
  V sum[N][M];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) sum[i][v] = out[i * width + v];
  for (long row = 0; row < BLOCK; ++row)
#pragma GCC unroll 4
    for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
      for (int v = 0; v < M; ++v) sum[i][v] += G[i * BLOCK + row] * X[row * width + v];
#pragma GCC unroll 4
  for (int i = 0; i < N; ++i)
#pragma GCC unroll 4
    for (int v = 0; v < M; ++v) out[i * width + v] = sum[i][v];
}
template <int N>
inline void tiles(const Real* G, const V* X, long width, V* out) {
  long v = 0;
  for (; v + 4 <= width; v += 4) tile<N, 4>(G, X + v, width, out + v);
  for (; v < width; ++v) tile<N, 1>(G, X + v, width, out + v);
}

// slopes (J, width) of weights from those of what they make, (J) of each row, and transposed inputs (rows, width)
inline void outer(const V* slopes, long J, const V* X, long width, V* out) {
  const Real* G = reinterpret_cast<const Real*>(slopes);
  long j = 0;
  for (; j + 4 <= J; j += 4) tiles<4>(G + j * BLOCK, X, width, out + j * width);
  for (; j < J; ++j) tiles<1>(G + j * BLOCK, X, width, out + j * width);
}

// the same for few inputs, (J, K), rows still to be summed up: each entry is a vector
inline void pairs(const V* slopes, long J, const V* X, long K, V* out) {
  for (long j = 0; j < J; ++j)
    for (long k = 0; k < K; ++k) {
      V sum = out[j * K + k];
      for (int w = 0; w < WIDE; ++w) sum += slopes[j * WIDE + w] * X[k * WIDE + w];
      out[j * K + k] = sum;
    }
}
inline void total(const Rows& sums, Real* out) {
  for (size_t i = 0; i < sums.size(); ++i) {
    Real sum = 0;
    for (int lane = 0; lane < LANES; ++lane) sum += sums[i][lane];
    out[i] = sum;
  }
}

// vectors that hold so many numbers
inline long vectors(long numbers) { return (numbers + LANES - 1) / LANES; }

// units with the rows last as rows of units
inline void transpose(const V* from, long units, V* to, long width) {
  const Real* entries = reinterpret_cast<const Real*>(from);
  Real* rows = reinterpret_cast<Real*>(to);
  for (long unit = 0; unit < units; ++unit)
    for (long row = 0; row < BLOCK; ++row) rows[row * width * LANES + unit] = entries[unit * BLOCK + row];
}

// out (J) += W (J, K) in (K)
inline void multiply(const Real* W, long J, long K, const V* in, V* out) {
  long j = 0;
  for (; j + 4 <= J; j += 4) some<4>(W + j * K, K, K, in, out + j * WIDE);
  for (; j < J; ++j) some<1>(W + j * K, K, K, in, out + j * WIDE);
}

// rows of a block: numbers `from + row * stride + unit` to and from lanes
struct Block {
  long number, first, count;

  void take(const Real* from, long stride, long units, V* to) const {
    Real* entries = reinterpret_cast<Real*>(to);
    for (long unit = 0; unit < units; ++unit)
      for (long row = 0; row < BLOCK; ++row)
        entries[unit * BLOCK + row] = row < count ? from[(first + row) * stride + unit] : Real(0);
  }
  void give(const V* from, long units, Real* to, long stride) const {
    const Real* entries = reinterpret_cast<const Real*>(from);
    for (long row = 0; row < count; ++row)
      for (long unit = 0; unit < units; ++unit) to[(first + row) * stride + unit] = entries[unit * BLOCK + row];
  }
};

// states kept of all blocks: (steps, units, padded)
struct Kept {
  Real* all;
  long units, padded;

  Real* at(long t, long unit, const Block& block) const { return all + (t * units + unit) * padded + block.first; }
  void store(const V* from, long t, const Block& block) const {
    for (long i = 0; all && i < units; ++i) std::memcpy(at(t, i, block), from + i * WIDE, sizeof(Row));
  }
  void load(V* to, long t, const Block& block) const {
    for (long i = 0; i < units; ++i) std::memcpy(to + i * WIDE, at(t, i, block), sizeof(Row));
  }
};

template <class F>
inline void each_block(long rows, long threads, F f) {
  const long blocks = (rows + BLOCK - 1) / BLOCK;
  std::atomic<long> next{0};
  auto work = [&] {
    const NormalOnly flushed;
    for (long i = next++; i < blocks; i = next++) f(Block{i, i * BLOCK, std::min<long>(rows - i * BLOCK, BLOCK)});
  };
  std::vector<std::thread> helpers;
  for (long k = 1; k < (threads < blocks ? threads : blocks); ++k) helpers.emplace_back(work);
  work();
  for (auto& helper : helpers) helper.join();
}

// one step of an LSTM for a block: inputs, one and state below each other -> gates
struct Memory {
  const Real *features, *keep, *weight;
  long steps, inputs, h, width = inputs + 1 + h;
  Rows in = Rows(width * WIDE), gate = Rows(4 * h * WIDE), kept = Rows(WIDE);

  V* state() { return &in[(inputs + 1) * WIDE]; }
  void step(long t, const Block& block) {
    block.take(features + t * inputs, steps * inputs, inputs, in.data());
    block.take(keep + t, steps, 1, kept.data());
    for (int w = 0; w < WIDE; ++w) in[inputs * WIDE + w] = V{} + 1;
    std::fill(gate.begin(), gate.end(), V{});
    multiply(weight, 4 * h, width, in.data(), gate.data());
    for (long i = 0; i < 4 * h * WIDE; ++i)
      gate[i] = i / WIDE / h == 2 ? hyperbolic(gate[i]) : sigmoid(gate[i]);
  }
};

// one step of a GRU for a block -> own part of the candidate, reset, update, candidate
struct Decoder {
  const Real *control, *hidden, *bias;
  long h, fed;
  Rows fixed = Rows(3 * h * WIDE), own = Rows(3 * h * WIDE), entering = Rows(3 * h * WIDE), gate = Rows(4 * h * WIDE);

  void step(const V* state, const V* before) {
    for (long j = 0; j < 3 * h; ++j)
      for (int w = 0; w < WIDE; ++w) own[j * WIDE + w] = V{} + bias[j];
    entering = fixed;
    if (before) multiply(control, 3 * h, fed, before, entering.data());
    multiply(hidden, 3 * h, h, state, own.data());
    for (long i = 0; i < h * WIDE; ++i) {
      const long u = h * WIDE + i, n = 2 * h * WIDE + i;
      const V reset = sigmoid(entering[i] + own[i]);
      gate[i] = own[n], gate[u] = reset, gate[n] = sigmoid(entering[u] + own[u]);
      gate[3 * h * WIDE + i] = hyperbolic(entering[n] + reset * own[n]);
    }
  }
};

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// Last state of an LSTM over rows with gaps: features (rows, steps, inputs), keep (rows, steps) 1 or 0, weight (4 h,
// inputs + 1 + h) -> last (rows, h), and where asked for states and memories before each step (h).
void dmmv_lstm(long rows, long threads, long steps, long inputs, long h, const Real* features, const Real* keep,
               const Real* weight, Real* last, Real* states_, Real* memories_) {
  const long padded = (rows + BLOCK - 1) / BLOCK * BLOCK;
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, padded}, memories{memories_, h, padded};
    Memory memory{features, keep, weight, steps, inputs, h};
    Rows c(h * WIDE);
    V* state = memory.state();
    for (long t = 0; t < steps; ++t) {
      states.store(state, t, block);
      memories.store(c.data(), t, block);
      memory.step(t, block);
      const V* gate = memory.gate.data();
      for (long i = 0; i < h * WIDE; ++i) {
        const V added = gate[i] * gate[2 * h * WIDE + i] + gate[h * WIDE + i] * c[i], k = memory.kept[i % WIDE];
        state[i] += k * (gate[3 * h * WIDE + i] * hyperbolic(added) - state[i]);
        c[i] += k * (added - c[i]);
      }
    }
    block.give(state, h, last, h);
  });
}

// Gradient for that in the last state: weight (blocks, 4 h, inputs + 1 + h filled up to whole vectors), and where asked
// for features (rows, steps, inputs). `back` are the transposed weights (inputs + 1 + h, 4 h).
void dmmv_lstm_adjoint(long rows, long threads, long steps, long inputs, long h, const Real* features, const Real* keep,
                       const Real* weight, const Real* back, const Real* g_last, Real* states_, Real* memories_,
                       Real* g_weight, Real* g_features) {
  const long padded = (rows + BLOCK - 1) / BLOCK * BLOCK;
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, padded}, memories{memories_, h, padded};
    Memory memory{features, keep, weight, steps, inputs, h};
    const long width = vectors(memory.width), into = inputs + 1;
    Rows c(h * WIDE), by_state(h * WIDE), by_memory(h * WIDE), slope(4 * h * WIDE), by_input(inputs * WIDE);
    Rows turned(BLOCK * width), total(4 * h * width);
    block.take(g_last, h, h, by_state.data());
    for (long t = steps - 1; t >= 0; --t) {
      states.load(memory.state(), t, block);
      memories.load(c.data(), t, block);
      memory.step(t, block);
      for (long i = 0; i < h * WIDE; ++i) {
        const V begin = memory.gate[i], forget = memory.gate[h * WIDE + i], k = memory.kept[i % WIDE];
        const V candidate = memory.gate[2 * h * WIDE + i], output = memory.gate[3 * h * WIDE + i];
        const V squashed = hyperbolic(begin * candidate + forget * c[i]);
        const V of_state = k * by_state[i], of_memory = k * by_memory[i];
        const V inner = of_memory + of_state * output * (1 - squashed * squashed);
        slope[i] = inner * candidate * begin * (1 - begin);
        slope[h * WIDE + i] = inner * c[i] * forget * (1 - forget);
        slope[2 * h * WIDE + i] = inner * begin * (1 - candidate * candidate);
        slope[3 * h * WIDE + i] = of_state * squashed * output * (1 - output);
        by_memory[i] += inner * forget - of_memory;
        by_state[i] -= of_state;
      }
      transpose(memory.in.data(), memory.width, turned.data(), width);
      outer(slope.data(), 4 * h, turned.data(), width, total.data());
      multiply(back + into * 4 * h, h, 4 * h, slope.data(), by_state.data());
      if (!g_features) continue;
      std::fill(by_input.begin(), by_input.end(), V{});
      multiply(back, inputs, 4 * h, slope.data(), by_input.data());
      block.give(by_input.data(), inputs, g_features + t * inputs, steps * inputs);
    }
    std::memcpy(g_weight + block.number * 4 * h * width * LANES, total.data(), total.size() * sizeof(V));
  });
}

// A GRU whose own emission is its input, see `emissions`: constant (rows, 3 h), start (rows, h) -> result (rows, steps,
// e), and where asked for states (h) of steps + 1 times.
void dmmv_gru(long rows, long threads, long steps, long h, long fed, long e, const Real* constant, const Real* start,
              const Real* control, const Real* hidden, const Real* bias, const Real* head, const Real* head_bias,
              Real* result, Real* states_) {
  const long padded = (rows + BLOCK - 1) / BLOCK * BLOCK;
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, padded};
    Decoder decoder{control, hidden, bias, h, fed};
    Rows state(h * WIDE), emitted(e * WIDE);
    block.take(constant, 3 * h, 3 * h, decoder.fixed.data());
    block.take(start, h, h, state.data());
    states.store(state.data(), 0, block);
    for (long t = 0; t < steps; ++t) {
      decoder.step(state.data(), t > 0 ? emitted.data() : nullptr);
      for (long i = 0; i < h * WIDE; ++i) {
        const V update = decoder.gate[2 * h * WIDE + i], candidate = decoder.gate[3 * h * WIDE + i];
        state[i] = candidate + update * (state[i] - candidate);
      }
      states.store(state.data(), t + 1, block);
      for (long j = 0; j < e; ++j)
        for (int w = 0; w < WIDE; ++w) emitted[j * WIDE + w] = V{} + head_bias[j];
      multiply(head, e, h, state.data(), emitted.data());
      block.give(emitted.data(), e, result + t * e, steps * e);
    }
  });
}

// Gradients for that in the result: constant (rows, 3 h), start (rows, h), and of each block: hidden with the rows of
// candidate, reset, update (3 h, h filled up to whole vectors), and behind each other control (3 h, fed), all biases of
// own part, reset, update, what enters the candidate (4 h), head (e, h), its bias (e). Transposed weights: `control_back`
// (fed, 3 h), `hidden_back` (h, 3 h) with the columns of candidate, reset, update, `head_back` (h, e).
void dmmv_gru_adjoint(long rows, long threads, long steps, long h, long fed, long e, const Real* constant,
                      const Real* control, const Real* hidden, const Real* bias, const Real* control_back,
                      const Real* hidden_back, const Real* head_back, const Real* result, const Real* g_result,
                      Real* states_, Real* g_constant, Real* g_start, Real* g_hidden, Real* g_others) {
  const long padded = (rows + BLOCK - 1) / BLOCK * BLOCK, width = vectors(h);
  const long others = 3 * h * fed + 4 * h + e * h + e;
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, padded};
    Decoder decoder{control, hidden, bias, h, fed};
    Rows before(h * WIDE), after(h * WIDE), slope(h * WIDE), all(4 * h * WIDE), emitted(e * WIDE), given(fed * WIDE);
    Rows by_constant(3 * h * WIDE), turned(BLOCK * width), by_hidden(3 * h * width), one(WIDE, V{} + 1);
    Rows by_control(3 * h * fed), by_bias(4 * h), by_head(e * h), by_head_bias(e);
    block.take(constant, 3 * h, 3 * h, decoder.fixed.data());
    states.load(after.data(), steps, block);
    for (long t = steps - 1; t >= 0; --t) {
      states.load(before.data(), t, block);
      block.take(g_result + t * e, steps * e, e, emitted.data());
      if (t < steps - 1) multiply(control_back, fed, 3 * h, &all[h * WIDE], emitted.data());
      if (t > 0) block.take(result + (t - 1) * e, steps * e, fed, given.data());
      decoder.step(before.data(), t > 0 ? given.data() : nullptr);
      multiply(head_back, h, e, emitted.data(), slope.data());
      pairs(emitted.data(), e, after.data(), h, by_head.data());
      pairs(emitted.data(), e, one.data(), 1, by_head_bias.data());
      for (long i = 0; i < h * WIDE; ++i) {
        const long r = h * WIDE + i, u = 2 * h * WIDE + i, n = 3 * h * WIDE + i;
        const V own = decoder.gate[i], reset = decoder.gate[r], update = decoder.gate[u], candidate = decoder.gate[n];
        all[u] = slope[i] * (before[i] - candidate) * update * (1 - update);
        all[n] = slope[i] * (1 - update) * (1 - candidate * candidate);
        all[r] = all[n] * own * reset * (1 - reset);
        all[i] = all[n] * reset;
        slope[i] *= update;
      }
      for (long i = 0; i < 3 * h * WIDE; ++i) by_constant[i] += all[h * WIDE + i];
      if (t > 0) pairs(&all[h * WIDE], 3 * h, given.data(), fed, by_control.data());
      pairs(all.data(), 4 * h, one.data(), 1, by_bias.data());
      transpose(before.data(), h, turned.data(), width);
      outer(all.data(), 3 * h, turned.data(), width, by_hidden.data());
      multiply(hidden_back, h, 3 * h, all.data(), slope.data());
      std::swap(before, after);
    }
    block.give(by_constant.data(), 3 * h, g_constant, 3 * h);
    block.give(slope.data(), h, g_start, h);
    std::memcpy(g_hidden + block.number * 3 * h * width * LANES, by_hidden.data(), by_hidden.size() * sizeof(V));
    Real* rest = g_others + block.number * others;
    total(by_control, rest);
    total(by_bias, rest + 3 * h * fed);
    total(by_head, rest + 3 * h * fed + 4 * h);
    total(by_head_bias, rest + 3 * h * fed + 4 * h + e * h);
  });
}

}  // extern "C"
#pragma GCC visibility pop
