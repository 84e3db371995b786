#include "runtime/vk/timestamps.h"

namespace shale::vk {

Result<Timestamps> Timestamps::create(const Context& context, uint32_t intervals) {
  if (context.timestamp_bits == 0)
    return unsupported(context.caps.name, "queue family {} has no timestamps",
                       context.queue_family);
  Timestamps result;
  result.vk_ = context.vk;
  result.device_ = context.device;
  result.capacity_ = intervals + 1;
  result.mask_ =
      context.timestamp_bits == 64 ? ~uint64_t{0} : (uint64_t{1} << context.timestamp_bits) - 1;
  result.period_us_ = static_cast<double>(context.limits.timestampPeriod) * 1e-3;
  auto info = init<VkQueryPoolCreateInfo>(VK_STRUCTURE_TYPE_QUERY_POOL_CREATE_INFO);
  info.queryType = VK_QUERY_TYPE_TIMESTAMP;
  info.queryCount = result.capacity_;
  SHALE_TRY(result.pool_, make(context.vk.CreateQueryPool, context.vk.DestroyQueryPool,
                               "vkCreateQueryPool", context.device, info));
  return result;
}

void Timestamps::start(VkCommandBuffer commands) {
  vk_.CmdResetQueryPool(commands, pool_.get(), 0, capacity_);
  used_ = 0;
  mark(commands);
}

void Timestamps::mark(VkCommandBuffer commands) {
  if (used_ < capacity_)
    vk_.CmdWriteTimestamp(commands, VK_PIPELINE_STAGE_BOTTOM_OF_PIPE_BIT, pool_.get(), used_);
  ++used_;
}

Result<std::vector<double>> Timestamps::read_us() const {
  if (used_ > capacity_)
    return bad_input("", "{} intervals were marked, the timestamps hold {}", used_ - 1,
                     intervals());
  std::vector<uint64_t> ticks(used_);
  if (!ticks.empty())
    SHALE_TRY_VOID(check(
        vk_.GetQueryPoolResults(device_, pool_.get(), 0, used_, ticks.size() * sizeof(uint64_t),
                                ticks.data(), sizeof(uint64_t),
                                VK_QUERY_RESULT_64_BIT | VK_QUERY_RESULT_WAIT_BIT),
        "vkGetQueryPoolResults"));
  std::vector<double> times;
  for (size_t i = 1; i < ticks.size(); ++i)
    times.push_back(static_cast<double>((ticks[i] - ticks[i - 1]) & mask_) * period_us_);
  return times;
}

}  // namespace shale::vk
