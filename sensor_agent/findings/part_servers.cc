#include "sensor_agent/findings/part_servers.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/types/span.h"

namespace rips::sensor {
namespace {

using ros2::Guid;

constexpr absl::string_view kModeOrder = "/change_mode";
constexpr absl::string_view kByManager[] = {kModeOrder, "/get_mode", "/get_available_modes"};
// The node of that name serves these; of a system, its mode manager does.
constexpr absl::string_view kByNode[] = {"/get_state", "/change_state", "/get_parameters",
                                         "/set_parameters", "/set_parameters_atomically"};

// `service` less the suffix that it has; empty = it has none of them.
absl::string_view Before(absl::string_view service, absl::Span<const absl::string_view> suffixes) {
  for (const absl::string_view suffix : suffixes) {
    if (absl::EndsWith(service, suffix)) return service.substr(0, service.size() - suffix.size());
  }
  return {};
}

absl::string_view PartServedBy(absl::string_view service) {
  const absl::string_view part = Before(service, kByNode);
  return part.empty() ? Before(service, kByManager) : part;
}

}  // namespace

void PartServers::Upsert(const ros2::Endpoint& endpoint, int64_t now_ns,
                         const PartServers& before) {
  const std::string part(PartServedBy(endpoint.name));
  if (part.empty()) return;
  const auto [it, is_new] = parts_[part].try_emplace(endpoint.guid);
  Served& served = it->second;
  if (is_new) {
    part_of_[endpoint.guid] = part;
    served.seen_ns = now_ns;
    const auto old_part = before.parts_.find(part);
    if (old_part != before.parts_.end()) {
      const auto old = old_part->second.find(endpoint.guid);
      if (old != old_part->second.end()) served.seen_ns = old->second.seen_ns;
    }
  }
  served.service = endpoint.name;
  served.node = endpoint.node;
  served.unclaimed = endpoint.node.empty() && !endpoint.pending;
}

void PartServers::Drop(const Guid& endpoint) {
  const auto of = part_of_.find(endpoint);
  if (of == part_of_.end()) return;
  const auto part = parts_.find(of->second);
  part->second.erase(endpoint);
  if (part->second.empty()) parts_.erase(part);
  part_of_.erase(of);
}

void PartServers::DropAllOf(const Guid& participant) {
  Guid first = participant;
  std::fill(first.bytes.begin() + 12, first.bytes.end(), uint8_t{0});
  for (auto it = part_of_.lower_bound(first);
       it != part_of_.end() && it->first.SamePrefix(participant);
       it = part_of_.lower_bound(first)) {
    Drop(Guid(it->first));
  }
}

absl::btree_map<absl::string_view, PartServers::Server> PartServers::ByService(
    const ServedBy& served) {
  absl::btree_map<absl::string_view, Server> servers;
  for (const auto& [guid, each] : served) {
    Server& server = servers[each.service];
    const Guid participant = guid.Participant();
    server.all.insert(participant);
    if (each.seen_ns > server.first_ns) continue;
    const bool tie = each.seen_ns == server.first_ns && server.first != participant;
    server.first_ns = each.seen_ns;
    server.first = tie ? std::nullopt : std::optional<Guid>(participant);
  }
  return servers;
}

std::optional<PartServers::Server> PartServers::ChangeModeOf(absl::string_view part) const {
  const auto served = parts_.find(part);
  if (served == parts_.end()) return std::nullopt;
  auto servers = ByService(served->second);
  const auto found = servers.find(absl::StrCat(part, kModeOrder));
  return found == servers.end() ? std::nullopt : std::optional(std::move(found->second));
}

absl::btree_map<Guid, PartServers::Rival> PartServers::RivalsOf(
    absl::string_view part, const absl::btree_set<Guid>* owners) const {
  absl::btree_map<Guid, Rival> rivals;
  const auto served = parts_.find(part);
  if (served == parts_.end()) return rivals;
  const auto servers = ByService(served->second);
  for (const auto& [guid, each] : served->second) {
    const Guid participant = guid.Participant();
    const Server& server = servers.at(each.service);
    const bool beside = server.all.size() > 1 && server.first != participant;
    const bool elsewhere = owners != nullptr && !owners->contains(participant) &&
                           !Before(each.service, kByNode).empty();
    if (!beside && !elsewhere && !each.unclaimed) continue;
    Rival& rival = rivals[participant];
    rival.services.insert(each.service);
    if (!each.node.empty()) rival.node = each.node;
    int64_t& since_ns = each.unclaimed ? rival.unclaimed_ns : rival.claimed_ns;
    since_ns = std::min(since_ns, each.seen_ns);
  }
  return rivals;
}

}  // namespace rips::sensor
