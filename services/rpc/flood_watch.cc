#include "services/rpc/flood_watch.h"

#include <string>

namespace rips::rpc {
namespace {

constexpr char kAll[] = "";
// Addresses of one window; those beyond it are counted together.
constexpr size_t kAddressesMax = 8'192;

}  // namespace

void FloodWatch::BeginWindow(int64_t now_ns) {
  begun_ns_ = now_ns;
  addresses_.clear();
  others_ = 0;
  absl::erase_if(told_ns_,
                 [&](const auto& told) { return now_ns - told.second >= limits_.told_ns; });
}

std::optional<FloodWatch::Flood> FloodWatch::Count(const std::string& address, int64_t now_ns) {
  if (now_ns - begun_ns_ >= limits_.window_ns) BeginWindow(now_ns);
  const bool room = addresses_.size() < kAddressesMax;
  Address& of_it = room ? addresses_[address] : addresses_.try_emplace(kAll).first->second;
  ++of_it.connections;
  if (!of_it.told) ++others_;
  const int64_t within_ns = now_ns - begun_ns_;
  if (room && !of_it.told && of_it.connections >= limits_.of_address) {
    of_it.told = true;
    others_ -= of_it.connections;
    if (!told_ns_.try_emplace(address, now_ns).second) return std::nullopt;
    return Flood{.address = address, .connections = of_it.connections, .within_ns = within_ns};
  }
  if (of_it.told || others_ < limits_.of_all) return std::nullopt;
  if (!told_ns_.try_emplace(kAll, now_ns).second) return std::nullopt;
  size_t addresses = 0;
  for (const auto& [name, each] : addresses_) addresses += each.told ? 0 : 1;
  return Flood{
      .address = address, .addresses = addresses, .connections = others_, .within_ns = within_ns};
}

}  // namespace rips::rpc
