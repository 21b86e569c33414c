// Gaussian controls from a GRU whose own emission is its input, over many rows. Kept for the backward pass are the states,
// (blocks, steps + 1, rows of a block, units filled up to whole vectors); the gates are computed again. Rows without a
// gradient are left out. Slopes of weights are one matrix per block, to be summed in the order of the blocks.
#pragma once
#include "lanes.hpp"

namespace {

struct Weights {
  const Real *control, *hidden, *bias, *head, *head_bias;  // (3 h, m), (3 h, h), (3 h), (e, h), (e)
  const Real *width, *range;                               // of the controls (m); of the scales, their size at zero
};

struct Sizes {
  long steps, h, m;

  long emitted() const { return m + m * (m + 1) / 2; }
  long kept() const { return vectors(h) * LANES; }  // numbers of a state that is kept
  Real* state(Real* states, long row, long t) const {
    return states + ((row / BLOCK * (steps + 1) + t) * BLOCK + row % BLOCK) * kept();
  }
};

// the GRU and what is made of its emissions, for a block
struct Decoder {
  Weights by;
  Sizes of;
  long part = of.h * WIDE, e = of.emitted();
  // what is there before a step, and after it: own part of the candidate, reset, update, candidate
  Rows fixed = Rows(4 * part), gate = Rows(4 * part);
  Rows head_start = Rows(e * WIDE), emitted = Rows(e * WIDE);

  void begin(const Real* constant, const Block& block) {
    block.take(constant, 3 * of.h, 3 * of.h, &fixed[part]);
    for (long i = 0; i < 2 * part; ++i) fixed[part + i] += by.bias[i / WIDE];
    for (long i = 0; i < part; ++i) fixed[i] = V{} + by.bias[2 * of.h + i / WIDE];
    for (long i = 0; i < e * WIDE; ++i) head_start[i] = V{} + by.head_bias[i / WIDE];
  }

  // gates from a state and the emission of the step before
  void step(const V* state, const V* before) {
    const long h = of.h;
    const V* entering = &fixed[part];
    if (before) {
      product(by.control, 3 * h, of.m, before, WIDE, entering, &gate[part]);
      entering = &gate[part];
    } else {
      std::copy(entering + 2 * part, entering + 3 * part, &gate[3 * part]);
    }
    product(by.hidden, 2 * h, h, state, WIDE, entering, &gate[part]);
    product(by.hidden + 2 * h * h, h, h, state, WIDE, fixed.data(), gate.data());
    // one after the other: a processor works on as many entries at once as do not wait for each other
    for (long i = part; i < 3 * part; ++i) gate[i] = sigmoid(gate[i]);
    for (long i = 0; i < part; ++i) gate[3 * part + i] = hyperbolic(gate[3 * part + i] + gate[part + i] * gate[i]);
  }
  void emit(const V* state) { product(by.head, e, of.h, state, WIDE, head_start.data(), emitted.data()); }

  // factor (m, m) of the covariance of the controls from what is emitted for it, and the squashed emissions
  void scale(V* squashed, V* factor) const {
    const V limit = V{} + by.range[0];
    const V* raw = &emitted[of.m * WIDE];
    for (long i = 0; i < (e - of.m) * WIDE; ++i) squashed[i] = hyperbolic(raw[i] / limit);
    long below = of.m;
    for (long i = 0; i < of.m; ++i) {
      for (long j = 0; j < of.m * WIDE; ++j) factor[i * of.m * WIDE + j] = V{};
      for (int w = 0; w < WIDE; ++w) {
        const V own = by.width[i] * by.range[1] * exponential(limit * squashed[i * WIDE + w]);
        factor[(i * of.m + i) * WIDE + w] = own;
        for (long j = 0; j < i; ++j)
          factor[(i * of.m + j) * WIDE + w] = own * limit * squashed[(below + j) * WIDE + w];
      }
      below += i;
    }
  }
};

// whether a row of slopes is zero throughout; what is no number is not
inline bool is_zero(const Real* slopes, long count) {
  for (long i = 0; i < count; ++i)
    if (slopes[i] != 0) return false;
  return true;
}

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// constant (rows, 3 h), start (rows, h), base (rows, steps, m), and weights -> controls (rows, steps, m), Cholesky
// factors of their covariances (rows, steps, m, m), and where asked for states.
void dmmv_controls(long rows, long threads, long steps, long h, long m, const Real* constant, const Real* start,
                   const Real* base, const Real* control, const Real* hidden, const Real* bias, const Real* head,
                   const Real* head_bias, const Real* width, const Real* range, Real* controls, Real* scales,
                   Real* states) {
  const Weights weights{control, hidden, bias, head, head_bias, width, range};
  const Sizes of{steps, h, m};
  each_block(rows, threads, [=](Block block) {
    Decoder decoder{weights, of};
    Rows state(vectors(h) * BLOCK), factor(m * m * WIDE), squashed((decoder.e - m) * WIDE), own(m * WIDE);
    decoder.begin(constant, block);
    block.take(start, h, h, state.data());
    const long kept = of.kept();
    auto keep = [&](long t) {
      if (states) Block{0, 0, BLOCK}.give<stream>(state.data(), kept, of.state(states, block.first, t), kept);
    };
    keep(0);
    for (long s = 0; s < steps; ++s) {
      decoder.step(state.data(), s > 0 ? decoder.emitted.data() : nullptr);
      for (long i = 0; i < decoder.part; ++i) {
        const V update = decoder.gate[2 * decoder.part + i], candidate = decoder.gate[3 * decoder.part + i];
        state[i] = candidate + update * (state[i] - candidate);
      }
      keep(s + 1);
      decoder.emit(state.data());
      decoder.scale(squashed.data(), factor.data());
      block.take(base + s * m, steps * m, m, own.data());
      for (long i = 0; i < m * WIDE; ++i) own[i] += width[i / WIDE] * decoder.emitted[i];
      block.give(own.data(), m, controls + s * m, steps * m);
      block.give(factor.data(), m * m, scales + s * m * m, steps * m * m);
    }
  });
}

// Gradients for those in controls and scales: constant (rows, 3 h), start (rows, h), and of each block that is returned:
// hidden with the rows of candidate, reset, update (3 h, h filled up to whole vectors), and behind each other control
// (3 h, m), biases of own part, reset, update, what enters the candidate (4 h), head (e, h), its bias (e). Transposed
// weights: `control_back` (m, 3 h), `hidden_back` (h, 3 h) with the columns of candidate, reset, update, `head_back`
// (h, e).
long dmmv_controls_adjoint(long rows, long threads, long steps, long h, long m, const Real* constant,
                           const Real* control, const Real* hidden, const Real* bias, const Real* head,
                           const Real* head_bias, const Real* width, const Real* range, const Real* control_back,
                           const Real* hidden_back, const Real* head_back, Real* states, const Real* g_controls,
                           const Real* g_scales, Real* g_constant, Real* g_start, Real* g_hidden, Real* g_others) {
  const Weights weights{control, hidden, bias, head, head_bias, width, range};
  const Sizes of{steps, h, m};
  const long e = of.emitted(), kept = of.kept(), columns = vectors(h), others = 3 * h * m + 4 * h + e * h + e;
  std::vector<long> live;
  for (long row = 0; row < rows; ++row)
    if (is_zero(g_controls + row * steps * m, steps * m) &&
        is_zero(g_scales + row * steps * m * m, steps * m * m)) {
      std::fill_n(g_constant + row * 3 * h, 3 * h, Real(0));
      std::fill_n(g_start + row * h, h, Real(0));
    } else {
      live.push_back(row);
    }
  const long* numbers = live.data();
  each_block(long(live.size()), threads, [=](Block block) {
    Decoder decoder{weights, of};
    const long part = decoder.part, s_count = e - m;
    Rows before(vectors(h) * BLOCK), after(vectors(h) * BLOCK), slope(part), all(4 * part), wanted(e * WIDE);
    Rows squashed(s_count * WIDE), factor(m * m * WIDE), by_factor(m * m * WIDE), by_control_(m * WIDE);
    Rows by_constant(3 * part), turned(BLOCK * columns), by_hidden(3 * h * columns), by_own(part);
    Rows by_control(3 * h * m), by_head(e * h), by_head_bias(e), one(WIDE, V{} + 1);
    decoder.begin(constant, block);
    auto recall = [&](long t, V* to) {
      for (long row = 0; row < block.count; ++row)
        std::memcpy(&turned[row * columns], of.state(states, block.place(row), t), kept * sizeof(Real));
      turn_back(turned.data(), columns, columns * LANES, to);
    };
    recall(steps, after.data());
    decoder.emit(after.data());
    for (long s = steps - 1; s >= 0; --s) {
      // slopes of the emissions, that of the next step's input included
      std::fill(wanted.begin(), wanted.end(), V{});
      if (s < steps - 1) add_product(control_back, m, 3 * h, &all[part], WIDE, wanted.data());
      decoder.scale(squashed.data(), factor.data());
      block.take(g_controls + s * m, steps * m, m, by_control_.data());
      for (long i = 0; i < m * WIDE; ++i) wanted[i] += width[i / WIDE] * by_control_[i];
      block.take(g_scales + s * m * m, steps * m * m, m * m, by_factor.data());
      V* raw = &wanted[m * WIDE];
      long below = m;
      for (long i = 0; i < m; ++i) {
        for (long j = 0; j <= i; ++j)
          for (int w = 0; w < WIDE; ++w) {
            const V given = by_factor[(i * m + j) * WIDE + w];
            raw[i * WIDE + w] += given * factor[(i * m + j) * WIDE + w];
            if (j < i) raw[(below + j) * WIDE + w] += given * factor[(i * m + i) * WIDE + w];
          }
        below += i;
      }
      for (long i = 0; i < s_count * WIDE; ++i) wanted[m * WIDE + i] *= 1 - squashed[i] * squashed[i];
      add_pairs(wanted.data(), e, after.data(), h, by_head.data());
      add_pairs(wanted.data(), e, one.data(), 1, by_head_bias.data());
      recall(s, before.data());
      for (long row = 0; s > 0 && row < block.count; ++row)
        announce(of.state(states, block.place(row), s - 1), kept);
      if (s > 0) decoder.emit(before.data());
      decoder.step(before.data(), s > 0 ? decoder.emitted.data() : nullptr);
      add_product(head_back, h, e, wanted.data(), WIDE, slope.data());
      for (long i = 0; i < part; ++i) {
        const V own = decoder.gate[i], reset = decoder.gate[part + i];
        const V update = decoder.gate[2 * part + i], candidate = decoder.gate[3 * part + i];
        all[2 * part + i] = slope[i] * (before[i] - candidate) * update * (1 - update);
        all[3 * part + i] = slope[i] * (1 - update) * (1 - candidate * candidate);
        all[part + i] = all[3 * part + i] * own * reset * (1 - reset);
        all[i] = all[3 * part + i] * reset;
        slope[i] *= update;
        by_own[i] += all[i];
        for (long p = 0; p < 3; ++p) by_constant[p * part + i] += all[(p + 1) * part + i];
      }
      if (s > 0) add_pairs(&all[part], 3 * h, decoder.emitted.data(), m, by_control.data());
      add_outer(all.data(), 3 * h, turned.data(), columns, by_hidden.data());
      add_product(hidden_back, h, 3 * h, all.data(), WIDE, slope.data());
      std::swap(before, after);
    }
    block.give(by_constant.data(), 3 * h, g_constant, 3 * h);
    block.give(slope.data(), h, g_start, h);
    std::memcpy(g_hidden + block.number * 3 * h * kept, by_hidden.data(), by_hidden.size() * sizeof(V));
    Real* rest = g_others + block.number * others;
    totals(by_control, rest);
    auto sums = [&](const Rows& of_units, Real* to) {
      for (size_t i = 0; i < of_units.size(); i += WIDE) {
        V sum = V{};
        for (int w = 0; w < WIDE; ++w) sum += of_units[i + w];
        *to++ = total(sum);
      }
    };
    sums(by_own, rest + 3 * h * m);
    sums(by_constant, rest + 3 * h * m + h);
    totals(by_head, rest + 3 * h * m + 4 * h);
    totals(by_head_bias, rest + 3 * h * m + 4 * h + e * h);
  }, numbers);
  return blocks_of(long(live.size()));
}

}  // extern "C"
#pragma GCC visibility pop
