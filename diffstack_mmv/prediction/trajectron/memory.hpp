// An LSTM over many rows with gaps. Kept for the backward pass are states and memories before each step, (blocks, steps,
// units, rows of a block), filled up with zeros; the gates are computed again. Slopes of weights are
// one matrix per block, to be summed in the order of the blocks: the same with any number of threads.
#pragma once
#include "lanes.hpp"

namespace {

// states kept of all blocks
struct Kept {
  Real* all;
  long units, steps;

  Real* at(long t, const Block& block) const { return all + (block.number * steps + t) * units * BLOCK; }
  void keep(const V* from, long t, const Block& block) const {
    for (long i = 0; all && i < units * WIDE; ++i) stream(from[i], at(t, block) + i * LANES);
  }
  // and asks for those of the step before
  void recall(V* to, long t, const Block& block) const {
    std::memcpy(to, at(t, block), units * BLOCK * sizeof(Real));
    if (t > 0) announce(at(t - 1, block), units * BLOCK);
  }
};

// one step for a block: inputs, one and state below each other -> gates (input, forget, candidate, output)
struct Memory {
  const Real *features, *keep, *weight;
  long steps, inputs, h, width = inputs + 1 + h;
  Rows in = Rows(width * WIDE), gate = Rows(4 * h * WIDE), none = Rows(4 * h * WIDE);
  V kept[WIDE];

  V* state() { return &in[(inputs + 1) * WIDE]; }
  void step(long t, const Block& block) {
    block.take(features + t * inputs, steps * inputs, inputs, in.data());
    block.take(keep + t, steps, 1, kept);
    for (long i = 0; i < inputs * WIDE; ++i) in[i] = kept[i % WIDE] != 0 ? in[i] : V{};  // whatever a gap holds
    for (int w = 0; w < WIDE; ++w) in[inputs * WIDE + w] = V{} + 1;
    product(weight, 4 * h, width, in.data(), WIDE, none.data(), gate.data());
    const long part = h * WIDE;
    for (long i = 0; i < 2 * part; ++i) gate[i] = sigmoid(gate[i]);
    for (long i = 2 * part; i < 3 * part; ++i) gate[i] = hyperbolic(gate[i]);
    for (long i = 3 * part; i < 4 * part; ++i) gate[i] = sigmoid(gate[i]);
  }
};

}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// Last state of an LSTM over rows with gaps: features (rows, steps, inputs), keep (rows, steps) 1 or 0, weight (4 h,
// inputs + 1 + h) -> last (rows, h), and where asked for states and memories before each step (h).
void dmmv_lstm(long rows, long threads, long steps, long inputs, long h, const Real* features, const Real* keep,
               const Real* weight, Real* last, Real* states_, Real* memories_) {
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, steps}, memories{memories_, h, steps};
    Memory memory{features, keep, weight, steps, inputs, h};
    Rows c(h * WIDE);
    V* state = memory.state();
    for (long t = 0; t < steps; ++t) {
      states.keep(state, t, block);
      memories.keep(c.data(), t, block);
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
  each_block(rows, threads, [=](Block block) {
    const Kept states{states_, h, steps}, memories{memories_, h, steps};
    Memory memory{features, keep, weight, steps, inputs, h};
    const long width = vectors(memory.width), into = inputs + 1;
    Rows c(h * WIDE), by_state(h * WIDE), by_memory(h * WIDE), slope(4 * h * WIDE), by_input(inputs * WIDE);
    Rows turned(BLOCK * width), sum(4 * h * width), none(inputs * WIDE);
    block.take(g_last, h, h, by_state.data());
    for (long t = steps - 1; t >= 0; --t) {
      states.recall(memory.state(), t, block);
      memories.recall(c.data(), t, block);
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
      turn(memory.in.data(), memory.width, turned.data(), width);
      add_outer(slope.data(), 4 * h, turned.data(), width, sum.data());
      add_product(back + into * 4 * h, h, 4 * h, slope.data(), WIDE, by_state.data());
      if (!g_features) continue;
      product(back, inputs, 4 * h, slope.data(), WIDE, none.data(), by_input.data());
      block.give(by_input.data(), inputs, g_features + t * inputs, steps * inputs);
    }
    std::memcpy(g_weight + block.number * 4 * h * width * LANES, sum.data(), sum.size() * sizeof(V));
  });
}

}  // extern "C"
#pragma GCC visibility pop
