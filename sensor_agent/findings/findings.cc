#include "sensor_agent/findings/findings.h"

#include <algorithm>
#include <tuple>

#include "absl/algorithm/container.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

using ros2::EndpointKind;
using ros2::Guid;

constexpr int64_t kMinuteNs = 60'000'000'000;
// Writers whose numbers jumped: as many as a topic watcher follows.
constexpr size_t kJumpsMax = 32'768;
// Participants named in a text.
constexpr size_t kNamedMax = 4;
constexpr absl::string_view kChangeMode = "/change_mode";
// Whoever calls these steers a part.
constexpr absl::string_view kSteering[] = {kChangeMode, "/change_state", "/set_parameters",
                                           "/set_parameters_atomically"};
constexpr const char* kKindNames[] = {"duplicate_node",      "impostor",        "false_claim",
                                      "foreign_mode_writer", "rival_server",    "non_ros_writer",
                                      "non_ros_reader",      "unauthenticated", "sequence_jump"};

// The part whose mode the service steers; empty = it is no such service.
absl::string_view PartOf(absl::string_view service) {
  for (const absl::string_view suffix : kSteering) {
    if (absl::EndsWith(service, suffix)) return service.substr(0, service.size() - suffix.size());
  }
  return {};
}

bool IsRipsName(absl::string_view node) { return absl::EndsWith(node, kOwnNode); }

// GUID prefixes of participants with DDS Security begin with a one (DDS Security 1.1 §9.3.3).
bool HasSecurePrefix(const Guid& guid) { return (guid.bytes[0] & 0x80) != 0; }

bool IsSuspect(const ros2::Endpoint& endpoint, const std::vector<std::string>& raw_readers) {
  if (!endpoint.ros) return false;
  const bool unclaimed = endpoint.node.empty() && !endpoint.pending;
  switch (endpoint.kind) {
    case EndpointKind::kPublisher:
      return unclaimed;
    case EndpointKind::kSubscriber:
      return unclaimed && !absl::c_linear_search(raw_readers, endpoint.name);
    case EndpointKind::kClient:
      return !PartOf(endpoint.name).empty();
    case EndpointKind::kService:
      return false;  // see PartServers
  }
  return false;
}

}  // namespace

absl::Span<const char* const> Findings::Kinds() { return kKindNames; }

Findings::Findings(FindingsOptions options) : options_(std::move(options)) {
  static_assert(std::size(kKindNames) == kKinds);
}

bool Findings::IsOwn(const Guid& participant) const {
  return participant == options_.own || own_participants_.contains(participant);
}

// --- Facts

void Findings::OnGraph(const GraphChange& change, int64_t now_ns) {
  dirty_ = true;
  if (change.from_version == 0) before_ = std::exchange(now_, {});
  for (const Guid& guid : change.delta.gone_guids) DropGuid(guid);
  for (const std::string& name : change.delta.gone_nodes) DropNode(name);
  for (const ros2::Participant& each : change.delta.upsert_participants) {
    UpsertParticipant(each, now_ns);
  }
  for (const ros2::Node& each : change.delta.upsert_nodes) UpsertNode(each);
  for (const ros2::Endpoint& each : change.delta.upsert_endpoints) UpsertEndpoint(each, now_ns);
  if (change.settled) before_ = {};
}

void Findings::UpsertParticipant(const ros2::Participant& participant, int64_t now_ns) {
  const auto [it, is_new] = now_.parties.try_emplace(participant.guid);
  if (is_new) {
    const auto before = before_.parties.find(participant.guid);
    it->second.seen_ns = before == before_.parties.end() ? now_ns : before->second.seen_ns;
  }
  it->second.host = participant.host;
  it->second.address = participant.address;
  it->second.pid = participant.pid;
}

void Findings::UpsertNode(const ros2::Node& node) {
  const auto party = now_.parties.find(node.participant);
  if (party == now_.parties.end()) return;
  party->second.shown = true;
  // Those of RIPS bear its name because we say so.
  if (IsOwn(node.participant)) return;
  party->second.nodes.insert(node.full_name);
  now_.owners[node.full_name].insert(node.participant);
}

void Findings::UpsertEndpoint(const ros2::Endpoint& endpoint, int64_t now_ns) {
  const auto party = now_.parties.find(endpoint.guid.Participant());
  if (party == now_.parties.end()) return;
  party->second.shown = true;
  if (!endpoint.ros && endpoint.kind == EndpointKind::kPublisher &&
      endpoint.name == ros2::kDiscoveryTopic) {
    party->second.announcer = endpoint.guid;
  }
  if (endpoint.ros && endpoint.kind == EndpointKind::kSubscriber && !endpoint.node.empty()) {
    now_.claimed.insert(endpoint.guid);
    // A slow node, which has not left. (A new reader that is pending proves nothing.)
    const auto held = held_.find({kNonRosReader, endpoint.guid.Participant(), endpoint.name});
    if (held != held_.end() && !held->second.told) held_.erase(held);
  }
  if (endpoint.ros && endpoint.kind == EndpointKind::kService) {
    now_.servers.Upsert(endpoint, now_ns, before_.servers);
  }
  if (!IsSuspect(endpoint, options_.raw_readers)) {
    now_.suspects.erase(endpoint.guid);
    return;
  }
  const auto [it, is_new] = now_.suspects.try_emplace(endpoint.guid);
  if (is_new) {
    const auto before = before_.suspects.find(endpoint.guid);
    it->second.seen_ns = before == before_.suspects.end() ? now_ns : before->second.seen_ns;
  }
  it->second.kind = endpoint.kind;
  it->second.name = endpoint.name;
  it->second.node = endpoint.node;
  it->second.was_claimed =
      now_.claimed.contains(endpoint.guid) || before_.claimed.contains(endpoint.guid);
  if (it->second.was_claimed) now_.claimed.insert(endpoint.guid);
}

void Findings::DropNode(const std::string& name) {
  const auto owners = now_.owners.find(name);
  if (owners == now_.owners.end()) return;
  for (const Guid& guid : owners->second) now_.parties.at(guid).nodes.erase(name);
  now_.owners.erase(owners);
}

void Findings::DropGuid(const Guid& guid) {
  const auto party = now_.parties.find(guid.Participant());
  if (guid != guid.Participant()) {
    now_.suspects.erase(guid);
    now_.claimed.erase(guid);
    now_.servers.Drop(guid);
    if (party != now_.parties.end() && party->second.announcer == guid) {
      party->second.announcer = Guid{};
    }
    return;
  }
  false_claims_.erase(guid);
  if (party == now_.parties.end()) return;
  for (const std::string& name : party->second.nodes) {
    const auto owners = now_.owners.find(name);
    owners->second.erase(guid);
    if (owners->second.empty()) now_.owners.erase(owners);
  }
  now_.parties.erase(party);
  Guid first = guid;
  std::fill(first.bytes.begin() + 12, first.bytes.end(), uint8_t{0});
  const auto begin = now_.suspects.lower_bound(first);
  auto end = begin;
  while (end != now_.suspects.end() && end->first.SamePrefix(guid)) ++end;
  now_.suspects.erase(begin, end);
  now_.servers.DropAllOf(guid);
  const auto claimed = now_.claimed.lower_bound(first);
  auto claimed_end = claimed;
  while (claimed_end != now_.claimed.end() && claimed_end->SamePrefix(guid)) ++claimed_end;
  now_.claimed.erase(claimed, claimed_end);
}

void Findings::OnEndpointSeen(const EndpointFact& endpoint, int64_t now_ns) {
  if (!endpoint.writer || glimpses_.contains(endpoint.guid)) return;
  ros2::DemangledTopic topic = ros2::DemangleTopic(endpoint.topic);
  if (topic.kind != ros2::DdsTopicKind::kServiceRequest || PartOf(topic.name).empty()) return;
  if (glimpses_.size() >= options_.findings_max) return;  // the graph shows most of them
  glimpses_[endpoint.guid] = {now_ns, std::move(topic.name)};
}

void Findings::OnSequenceJump(const Finding& jump) {
  if (jumps_.contains(jump.guid)) return;
  if (jumps_.size() >= kJumpsMax) {
    ++dropped_;
    return;
  }
  jumps_[jump.guid] = jump;
  dirty_ = true;
}

void Findings::OnParticipantGone(const Guid& participant) {
  dirty_ |= absl::erase_if(
                jumps_, [&](const auto& each) { return each.first.SamePrefix(participant); }) > 0;
}

void Findings::OnEndpointGone(const Guid& endpoint) {
  dirty_ |= jumps_.erase(endpoint) > 0;
  const auto it = glimpses_.find(endpoint);
  if (it == glimpses_.end()) return;
  const auto [seen_ns, service] = std::move(it->second);
  glimpses_.erase(it);
  const Key key{kForeignModeWriter, endpoint, ""};
  const Guid participant = endpoint.Participant();
  const absl::string_view part = PartOf(service);
  if (now_.suspects.contains(endpoint) || held_.contains(key)) return;  // the graph has shown it
  if (!protected_parts_.contains(part) || IsOwn(participant)) return;
  const Servers servers = CollectServers();
  const auto server = servers.find(part);
  if (server != servers.end() && server->second.first == participant) return;
  const auto held_of_kind = absl::c_count_if(
      held_, [](const auto& each) { return each.first.kind == kForeignModeWriter; });
  if (static_cast<size_t>(held_of_kind) >= options_.findings_max) {
    ++dropped_;
    return;
  }
  Held& held = held_[key];
  held.finding = {.kind = kKindNames[kForeignModeWriter],
                  .guid = endpoint,
                  .topic = service,
                  .detail = absl::StrCat(Describe(participant), " may steer this part")};
  held.due_ns = std::max(seen_ns, connected_ns_) + options_.foreign_grace_ns;
  held.gone = true;
  dirty_ = true;
}

void Findings::OnClaim(const Guid& writer, const absl::Status& taken, int64_t now_ns) {
  const Guid participant = writer.Participant();
  if (!absl::IsPermissionDenied(taken)) {
    dirty_ |= false_claims_.erase(participant) > 0;
    return;
  }
  if (false_claims_.contains(participant)) return;
  if (false_claims_.size() >= options_.findings_max) {
    ++dropped_;
    return;
  }
  false_claims_[participant] = {now_ns, std::string(taken.message())};
  dirty_ = true;
}

void Findings::SetOwnParticipants(const std::vector<Guid>& participants) {
  absl::btree_set<Guid> now(participants.begin(), participants.end());
  if (now == own_participants_) return;
  own_participants_ = std::move(now);
  dirty_ = true;
}

void Findings::SetProtectedParts(const std::vector<std::string>& parts) {
  absl::btree_set<std::string> now(parts.begin(), parts.end());
  if (now == protected_parts_) return;
  protected_parts_ = std::move(now);
  dirty_ = true;
}

void Findings::SetConnected(bool connected, int64_t now_ns) {
  if (connected == connected_) return;
  connected_ = connected;
  dirty_ = true;
  if (!connected) return;
  connected_ns_ = now_ns;
  for (auto& [key, held] : held_) {
    if (held.gone) held.due_ns = now_ns + options_.foreign_grace_ns;
  }
}

// --- What stands

std::string Findings::Describe(const Guid& participant) const {
  const auto party = now_.parties.find(participant);
  if (party == now_.parties.end() || party->second.host.empty()) {
    return absl::StrCat("participant ", ToString(participant));
  }
  const Party& it = party->second;
  return absl::StrCat("participant ", ToString(participant), " (says: host ", it.host,
                      it.address.empty() ? "" : ", address ", it.address, ", process ", it.pid,
                      ")");
}

void Findings::CollectNodes(WantedMap& wanted) {
  for (const auto& [name, owners] : now_.owners) {
    std::vector<Guid> others;
    for (const Guid& guid : owners) {
      if (!IsOwn(guid)) others.push_back(guid);
    }
    int64_t due_ns = 0;
    if (IsRipsName(name)) {
      for (const Guid& guid : others) {
        const int64_t impostor_due_ns = ForeignDue(now_.parties.at(guid).seen_ns);
        due_ns = std::max(due_ns, impostor_due_ns);
        if (Wanted* fresh = Want({kImpostor, guid, name}, impostor_due_ns, wanted)) {
          fresh->finding = {.guid = guid,
                            .node = name,
                            .detail = absl::StrCat("claimed by ", Describe(guid),
                                                   ", which is no agent that the server knows")};
        }
      }
    }
    if (others.size() < 2) continue;
    Wanted* fresh = Want({kDuplicateNode, Guid{}, name}, due_ns, wanted);
    if (fresh == nullptr) continue;
    // The last one to come is the more likely intruder.
    const Guid last =
        *std::max_element(others.begin(), others.end(), [&](const Guid& a, const Guid& b) {
          return now_.parties.at(a).seen_ns < now_.parties.at(b).seen_ns;
        });
    std::string detail = absl::StrCat("claimed by ", others.size(), " participants:");
    for (size_t i = 0; i < std::min(others.size(), kNamedMax); ++i) {
      absl::StrAppend(&detail, i == 0 ? " " : ", ", Describe(others[i]));
    }
    fresh->finding = {.guid = last, .node = name, .detail = std::move(detail)};
  }
}

void Findings::CollectClaims(int64_t now_ns, WantedMap& wanted) {
  for (auto it = false_claims_.begin(); it != false_claims_.end();) {
    const auto& [guid, claim] = *it;
    if (now_.parties.contains(guid)) {
      if (Wanted* fresh = Want({kFalseClaim, guid, ""}, 0, wanted)) {
        fresh->finding = {.guid = guid, .detail = claim.second};
      }
    } else if (now_ns >= claim.first + options_.orphan_claim_ns) {
      it = false_claims_.erase(it);
      continue;
    }
    ++it;
  }
}

bool Findings::MayBeOurs(const Key& key) {
  return key.kind == kForeignModeWriter || key.kind == kImpostor || key.kind == kNonRosReader ||
         (key.kind == kDuplicateNode && IsRipsName(key.node));
}

bool Findings::IsToldLate(const Key& key, const Held& held) const {
  if (IsOwn(key.guid.Participant())) return false;
  return key.kind == kImpostor || held.late ||
         (key.kind == kForeignModeWriter && !now_.suspects.contains(key.guid));
}

int64_t Findings::ForeignDue(int64_t seen_ns) const {
  return std::max(seen_ns, connected_ns_) + options_.foreign_grace_ns;
}

Findings::Wanted* Findings::Want(const Key& key, int64_t due_ns, WantedMap& wanted) {
  const auto held = held_.find(key);
  const bool is_held = held != held_.end();
  const bool is_new = !is_held && !wanted.contains(key);
  if (is_new && ++fresh_[key.kind] > options_.findings_max) return nullptr;
  Wanted& each = wanted[key];
  each.due_ns = due_ns;
  return is_held && held->second.told ? nullptr : &each;
}

Findings::Servers Findings::CollectServers() const {
  Servers servers;
  for (const std::string& part : protected_parts_) {
    std::optional<PartServers::Server> server = now_.servers.ChangeModeOf(part);
    if (server.has_value()) servers[part] = *std::move(server);
  }
  return servers;
}

void Findings::CollectRivals(WantedMap& wanted) {
  for (const std::string& part : protected_parts_) {
    const auto owners = now_.owners.find(part);
    const auto rivals =
        now_.servers.RivalsOf(part, owners == now_.owners.end() ? nullptr : &owners->second);
    for (const auto& [participant, rival] : rivals) {
      const bool nodeless = rival.unclaimed_ns != PartServers::kNone;
      int64_t due_ns = kNever;
      if (rival.claimed_ns != PartServers::kNone)
        due_ns = rival.claimed_ns + options_.rival_server_grace_ns;
      if (nodeless) {
        const bool announces = !now_.parties.at(participant).announcer.none();
        const int64_t slow_ns = announces ? options_.slow_node_ns : 0;
        due_ns = std::min(due_ns, rival.unclaimed_ns + slow_ns);
      }
      Wanted* fresh = Want({kRivalServer, participant, part}, due_ns, wanted);
      if (fresh == nullptr) continue;
      fresh->finding = {.guid = participant,
                        .node = rival.node,
                        .topic = *rival.services.begin(),
                        .detail = absl::StrCat(
                            Describe(participant), " serves ", absl::StrJoin(rival.services, ", "),
                            nodeless ? " without a node" : " beside the part's own server")};
    }
  }
}

void Findings::CollectModeWriters(WantedMap& wanted) {
  const Servers servers = CollectServers();
  for (const auto& [guid, suspect] : now_.suspects) {
    if (suspect.kind != EndpointKind::kClient) continue;
    const absl::string_view part = PartOf(suspect.name);
    const Guid participant = guid.Participant();
    if (!protected_parts_.contains(part) || IsOwn(participant)) continue;
    const auto server = servers.find(part);
    const bool serves = server != servers.end() && server->second.all.contains(participant);
    if (serves && server->second.first == participant) continue;
    const int64_t grace_ns = serves ? options_.rival_grace_ns : options_.foreign_grace_ns;
    Wanted* fresh = Want({kForeignModeWriter, guid, ""},
                         std::max(suspect.seen_ns, connected_ns_) + grace_ns, wanted);
    if (fresh == nullptr) continue;
    fresh->finding = {
        .guid = guid,
        .node = suspect.node,
        .topic = suspect.name,
        .detail = absl::StrCat(
            Describe(participant),
            serves ? " serves change_mode of this part beside its mode manager, and" : "",
            " may steer this part")};
  }
}

void Findings::CollectNonRos(WantedMap& wanted) {
  for (const auto& [guid, suspect] : now_.suspects) {
    const Guid participant = guid.Participant();
    if (suspect.kind != EndpointKind::kPublisher || IsOwn(participant)) continue;
    const bool announces = !now_.parties.at(participant).announcer.none();
    Wanted* fresh = Want({kNonRosWriter, guid, ""},
                         suspect.seen_ns + (announces ? options_.slow_node_ns : 0), wanted);
    if (fresh == nullptr) continue;
    fresh->finding = {.guid = guid,
                      .topic = suspect.name,
                      .detail = absl::StrCat(Describe(participant),
                                             announces ? " does not claim this writer for a node"
                                                       : " is no ROS process")};
  }
  for (const auto& [guid, suspect] : now_.suspects) {
    const Guid participant = guid.Participant();
    if (suspect.kind != EndpointKind::kSubscriber || IsOwn(participant)) continue;
    const Key key{kNonRosReader, participant, suspect.name};
    const auto held = held_.find(key);
    const bool announces = !now_.parties.at(participant).announcer.none();
    const bool late = !announces || !suspect.was_claimed;
    int64_t since_ns = suspect.seen_ns;
    if (held != held_.end()) since_ns = std::min(since_ns, held->second.since_ns);
    if (const auto other = wanted.find(key); other != wanted.end()) {
      since_ns = std::min(since_ns, other->second.since_ns);
    }
    const int64_t slow_ns = announces ? since_ns + options_.slow_node_ns : 0;
    Wanted* fresh = Want(key, std::max(slow_ns, ForeignDue(since_ns)), wanted);
    if (fresh == nullptr) continue;
    fresh->since_ns = since_ns;
    fresh->late |= late;
    fresh->finding = {.guid = participant,
                      .topic = suspect.name,
                      .detail = absl::StrCat(Describe(participant), " reads without a node")};
  }
}

void Findings::CollectStrangers(int64_t now_ns, WantedMap& wanted) {
  secured_strangers_ = 0;
  strangers_due_ns_ = kNever;
  for (const auto& [guid, party] : now_.parties) {
    if (party.shown || IsOwn(guid)) continue;
    const int64_t due_ns = party.seen_ns + options_.handshake_ns;
    if (options_.secured) {
      if (Wanted* fresh = Want({kUnauthenticated, guid, ""}, due_ns, wanted)) {
        fresh->finding = {.guid = guid,
                          .detail = absl::StrCat(Describe(guid), " has not authenticated")};
      }
    } else if (HasSecurePrefix(guid)) {
      if (due_ns <= now_ns) {
        ++secured_strangers_;
      } else {
        strangers_due_ns_ = std::min(strangers_due_ns_, due_ns);
      }
    }
  }
}

void Findings::CollectJumps(WantedMap& wanted) {
  for (const auto& [guid, jump] : jumps_) {
    Wanted* fresh = Want({kSequenceJump, guid, ""}, 0, wanted);
    if (fresh == nullptr) continue;
    fresh->finding = jump;
    fresh->finding.detail = absl::StrCat(Describe(guid.Participant()), ": ", jump.detail);
  }
}

Findings::WantedMap Findings::Collect(int64_t now_ns) {
  WantedMap wanted;
  fresh_ = {};
  CollectNodes(wanted);
  CollectClaims(now_ns, wanted);
  CollectModeWriters(wanted);
  CollectRivals(wanted);
  CollectNonRos(wanted);
  CollectStrangers(now_ns, wanted);
  CollectJumps(wanted);
  for (auto& [key, each] : wanted) {
    each.finding.kind = kKindNames[key.kind];
    if (each.finding.detail.size() > kFindingDetailBytesMax) {
      each.finding.detail.resize(kFindingDetailBytesMax);
    }
  }
  return wanted;
}

// --- What is told

std::vector<Finding> Findings::Poll(int64_t now_ns) {
  std::vector<Finding> told;
  if (!dirty_ && now_ns < next_due_ns_) return told;
  WantedMap wanted = Collect(now_ns);
  End(wanted, told);
  Begin(std::move(wanted));
  dirty_ = false;
  TurnWindows(now_ns, told);
  Tell(now_ns, told);
  ScheduleNext();
  return told;
}

void Findings::End(const WantedMap& wanted, std::vector<Finding>& told) {
  for (auto it = held_.begin(); it != held_.end();) {
    const auto& [key, held] = *it;
    if (wanted.contains(key)) {
      ++it;
      continue;
    }
    if (held.told) {
      told.push_back(held.finding);
      told.back().over = true;
    } else if (IsToldLate(key, held)) {
      it->second.gone = true;
      ++it;
      continue;
    } else if (held.withheld) {
      ++windows_[key.kind].folded;
    }
    it = held_.erase(it);
  }
}

void Findings::Begin(WantedMap wanted) {
  size_t not_held = 0;
  for (const size_t fresh : fresh_) {
    not_held += fresh > options_.findings_max ? fresh - options_.findings_max : 0;
  }
  std::array<size_t, kKinds> held_of = {};
  for (const auto& [key, held] : held_) ++held_of[key.kind];
  for (auto& [key, each] : wanted) {
    const auto it = held_.find(key);
    if (it != held_.end()) {
      if (it->second.told) continue;
      it->second.gone = false;
      it->second.due_ns = each.due_ns;
      it->second.late = each.late;
      it->second.since_ns = each.since_ns;
      // Its node may have become known meanwhile.
      it->second.finding = std::move(each.finding);
    } else if (held_of[key.kind] >= options_.findings_max) {
      ++not_held;
    } else {
      ++held_of[key.kind];
      held_[key] = Held{std::move(each)};
    }
  }
  if (not_held > not_held_) dropped_ += not_held - not_held_;
  not_held_ = not_held;
}

void Findings::TurnWindows(int64_t now_ns, std::vector<Finding>& told) {
  for (size_t kind = 0; kind < windows_.size(); ++kind) {
    Window& window = windows_[kind];
    if (window.told == 0 || now_ns < window.start_ns + kMinuteNs) continue;
    const uint64_t folded = window.folded;
    window = {};
    if (folded == 0) continue;
    window = {.start_ns = now_ns, .told = 1};
    Finding summary{.kind = kKindNames[kind],
                    .detail = absl::StrCat(folded, " more came and went within a minute")};
    told.push_back(summary);
    summary.over = true;
    told.push_back(std::move(summary));
  }
}

void Findings::Tell(int64_t now_ns, std::vector<Finding>& told) {
  // What stands before what has left.
  std::vector<std::tuple<bool, int64_t, Key>> due;
  for (const auto& [key, held] : held_) {
    if (held.told || held.due_ns > now_ns || !CanBeTold(key)) continue;
    due.emplace_back(held.gone, held.due_ns, key);
  }
  std::sort(due.begin(), due.end());
  for (const auto& [gone, due_ns, key] : due) {
    Held& held = held_.at(key);
    Window& window = windows_[key.kind];
    held.withheld = window.told >= options_.told_per_minute;
    if (held.withheld) {
      if (!gone) continue;
      ++window.folded;
      held_.erase(key);
      continue;
    }
    if (window.told++ == 0) window.start_ns = now_ns;
    told.push_back(held.finding);
    held.told = true;
    if (!gone) continue;
    told.back().detail = absl::StrCat("it has left: ", told.back().detail);
    told.push_back(told.back());
    told.back().over = true;
    held_.erase(key);
  }
}

void Findings::ScheduleNext() {
  next_due_ns_ = strangers_due_ns_;
  holds_untold_ = strangers_due_ns_ != kNever;
  for (const auto& [key, held] : held_) {
    holds_untold_ = holds_untold_ || (!held.told && !held.gone);
    if (held.told || !CanBeTold(key)) continue;
    const int64_t due_ns = held.withheld ? windows_[key.kind].start_ns + kMinuteNs : held.due_ns;
    next_due_ns_ = std::min(next_due_ns_, due_ns);
  }
  for (const Window& window : windows_) {
    if (window.folded > 0) next_due_ns_ = std::min(next_due_ns_, window.start_ns + kMinuteNs);
  }
}

std::vector<Finding> Findings::Told() const {
  std::vector<Finding> told;
  for (const auto& [key, held] : held_) {
    if (held.told) told.push_back(held.finding);
  }
  return told;
}

}  // namespace rips::sensor
