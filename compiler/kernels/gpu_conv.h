// compiler/kernels/gpu_conv.h -- what the convolution kernels of GPUs share: inputs read in words
// through folded views, weights and bias packed for the kernel, results.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "compiler/kernels/codegen.h"
#include "ir/base/integer.h"

namespace shale {

/// A conv2d with int8 input and constant int8 weights, as a GPU kernel sees it. The channels of a
/// tap are words of four: those of each tensor that the input is concatenated from, the last word
/// of a tensor filled up with zero weights. A slot is a channel's place in those words.
class GpuConv {
 public:
  /// The group must be one that `supports` accepts.
  explicit GpuConv(const GroupProblem& problem);

  /// True for a conv2d of the kind above with constant bias, behind no views but pads of height and
  /// width, resizes and concats of channels.
  static bool takes(const GroupProblem& problem);
  /// The same on a profile that keeps weights in buffers.
  static bool supports(const GroupProblem& problem, const DeviceProfile& profile);

  const Shape& in() const { return graph_.value(node_.inputs[0]).type.shape; }
  const Shape& weight() const { return graph_.value(node_.inputs[1]).type.shape; }
  const Shape& out() const { return graph_.value(node_.output).type.shape; }
  int64_t taps() const { return weight()[1] * weight()[2]; }
  int64_t words() const { return static_cast<int64_t>(channel_of_slot_.size()) / 4; }
  std::span<const int64_t> list(Attr attr) const { return node_.attrs.list(attr); }
  int64_t input_zp() const { return graph_.value(node_.inputs[3]).constant->get(0); }
  int64_t weight_zp() const { return graph_.value(node_.inputs[4]).constant->get(0); }

  /// A tensor in memory that the convolution reads.
  struct Part {
    ValueId value;
    int64_t channels = 0;
    int64_t first_word = 0;
    std::string steps;  ///< GLSL that leads from y and x of the input to those of the tensor
    int64_t words() const { return (channels + 3) / 4; }
    bool in_words() const { return channels % 4 == 0; }
  };
  const std::vector<Part>& parts() const { return parts_; }

  /// The stored weight of a tap's slot; 0 for what fills words and for channels past the last.
  int64_t stored_weight(int64_t oc, int64_t tap, int64_t slot) const;

  /// The same less the weights' zero point, which is int8 only where `centred_weights_are_int8`.
  int64_t centred_weight(int64_t oc, int64_t tap, int64_t slot) const;
  bool centred_weights_are_int8() const;

  /// Bias less what the input's zero point adds, since kernels multiply stored codes; wraps as
  /// TOSA's legal accumulators do. 0 past the last channel.
  int32_t folded_bias(int64_t oc) const;

  /// Appends folded_bias of [0, channels) as int32.
  void append_bias(std::vector<uint8_t>& bytes, int64_t channels) const;

  /// Declares for part i
  ///   int locate<i>(int n, int y, int x, out uint fill)  place of a pixel of the convolution's
  ///       input in the tensor; -1 outside, where four channels are `fill`
  ///   uint word<i>(int at, int k)                         word k of the pixel at such a place
  void declare_inputs(Codegen& codegen) const;

  /// Declares
  ///   void finish(ivec4 h, int n, int y, int x, int c)
  /// which adds the bias to the sums of channels c to c + 3 (c a multiple of four), applies the
  /// fused nodes and stores what lies inside the result. The bias is int32 from element `first` on
  /// of the uvec4 buffer `binding`.
  void declare_finish(Codegen& codegen, size_t binding, int64_t first) const;

 private:
  void walk(ValueId id, std::string steps, bool checked);

  const GroupProblem& problem_;
  const Graph& graph_;
  const Node& node_;
  std::vector<std::optional<NodeId>> producers_;
  std::vector<Part> parts_;
  std::vector<int64_t> channel_of_slot_;  ///< -1 for what fills a word
};

/// One dispatch of so many MACs, filling included, by int8 dot products or matrices.
WorkTable gpu_conv_work(const GroupProblem& problem, Work kind, double macs);

}  // namespace shale
