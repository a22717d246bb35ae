#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/dds/discovery.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_process.h"
#include "tests/support/ros2/forged_heartbeat.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::robot_sim {
namespace {

// To discover who is there.
constexpr absl::Duration kDiscoverTime = absl::Milliseconds(1'500);
constexpr absl::Duration kRivalPeriod = absl::Milliseconds(20);

// The servers of every part, without a node.
class Servers {
 public:
  Servers(const dds::Participant& participant, ModeMachine machine)
      : participant_(participant), machine_(std::move(machine)) {}

  absl::Status Serve() {
    std::vector<std::string> nodes;
    std::string system;
    {
      MutexLock lock(&mu_);
      system = machine_.system();
      for (const auto& [name, unused] : machine_.nodes()) nodes.push_back(name);
    }
    RIPS_RETURN_IF_ERROR(ServePart(system));
    for (const std::string& name : nodes) RIPS_RETURN_IF_ERROR(ServePart(name));
    for (const std::string& name : nodes) {
      RIPS_RETURN_IF_ERROR(parts_.at(name)->AddParameterServices(
          [this, name] {
            MutexLock lock(&mu_);
            return machine_.nodes().at(name).parameters;
          },
          [this, name](const actuator::ParameterMap& wanted) {
            MutexLock lock(&mu_);
            return machine_.SetParameters(name, wanted);
          }));
    }
    return absl::OkStatus();
  }
  void Advance() {
    MutexLock lock(&mu_);
    machine_.Advance(RealClock().Now().boottime_ns);
  }

 private:
  absl::Status ServePart(const std::string& part) {
    RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosNode> made, RosNode::CreateBare(participant_, part));
    RosNode& node = *(parts_[part] = std::move(made));
    RIPS_RETURN_IF_ERROR(
        node.Serve(absl::StrCat(part, "/change_mode"), ros2::kChangeModeType,
                   [this, part](absl::string_view request) -> std::optional<std::string> {
                     const auto mode = ros2::DecodeChangeModeRequest(request);
                     if (!mode.ok()) return std::nullopt;
                     MutexLock lock(&mu_);
                     const int64_t now_ns = RealClock().Now().boottime_ns;
                     const bool known = machine_.ChangeMode(part, *mode, now_ns);
                     machine_.Advance(now_ns);
                     return ros2::EncodeSuccessReply(known);
                   }));
    RIPS_RETURN_IF_ERROR(node.Serve(absl::StrCat(part, "/get_mode"), ros2::kGetModeType,
                                    [this, part](absl::string_view) {
                                      MutexLock lock(&mu_);
                                      return ros2::EncodeGetModeReply(machine_.Mode(part));
                                    }));
    RIPS_RETURN_IF_ERROR(node.Serve(absl::StrCat(part, "/get_available_modes"),
                                    ros2::kGetAvailableModesType, [this, part](absl::string_view) {
                                      MutexLock lock(&mu_);
                                      return ros2::EncodeGetAvailableModesReply(
                                          machine_.AvailableModes(part));
                                    }));
    RIPS_RETURN_IF_ERROR(
        node.Serve(absl::StrCat(part, "/change_state"), ros2::kChangeStateType,
                   [this, part](absl::string_view request) -> std::optional<std::string> {
                     const auto transition = ros2::DecodeChangeStateRequest(request);
                     if (!transition.ok()) return std::nullopt;
                     MutexLock lock(&mu_);
                     if (!machine_.nodes().contains(part)) return ros2::EncodeSuccessReply(true);
                     return ros2::EncodeSuccessReply(machine_.ChangeState(part, transition->id));
                   }));
    return node.Serve(absl::StrCat(part, "/get_state"), ros2::kGetStateType,
                      [this, part](absl::string_view) {
                        MutexLock lock(&mu_);
                        const Lifecycle state = machine_.State(part);
                        return ros2::EncodeGetStateReply(
                            {static_cast<uint8_t>(state), std::string(Label(state))});
                      });
  }

  const dds::Participant& participant_;  // Not owned; outlives this.
  Mutex mu_;
  ModeMachine machine_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, std::unique_ptr<RosNode>> parts_;
};

// Clients and other servers of services, as discovered.
class Others {
 public:
  explicit Others(const ros2::Guid& own) : own_(own) {}

  void Seen(const dds::EndpointSeen& endpoint) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (!endpoint.alive) {
      clients_.erase(endpoint.guid);
      servers_.erase(endpoint.guid);
      return;
    }
    const ros2::DemangledTopic topic = ros2::DemangleTopic(endpoint.topic);
    if (topic.kind != ros2::DdsTopicKind::kServiceRequest) return;
    if (endpoint.participant == own_) return;
    (endpoint.writer ? clients_ : servers_)[endpoint.guid] = topic.name;
  }
  // Each client with the participants that serve what it calls.
  std::set<std::pair<ros2::Guid, ros2::Guid>> Pairs() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    std::set<std::pair<ros2::Guid, ros2::Guid>> pairs;
    for (const auto& [client, called] : clients_) {
      for (const auto& [server, served] : servers_) {
        if (called == served) pairs.emplace(client, server.Participant());
      }
    }
    return pairs;
  }

 private:
  const ros2::Guid own_;
  mutable Mutex mu_;
  std::map<ros2::Guid, std::string> clients_ ABSL_GUARDED_BY(mu_);
  std::map<ros2::Guid, std::string> servers_ ABSL_GUARDED_BY(mu_);
};

absl::Status Deafen(const Others& others, uint32_t domain) {
  for (const auto& [client, server] : others.Pairs()) {
    // The manager's own clients hear it still.
    if (client.SamePrefix(server)) continue;
    RIPS_RETURN_IF_ERROR(dds::SendToDomain(domain, dds::ForgedHeartbeat(client, server)));
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status RunRival(const RivalCommand& command, StopFlag& stop) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadFile(command.smh_file));
  RIPS_ASSIGN_OR_RETURN(actuator::Smh smh, actuator::ParseSmh(text, command.smh_file));
  RIPS_ASSIGN_OR_RETURN(
      ModeMachine machine,
      ModeMachine::Create(std::move(smh), {.system = command.system, .transition_ns = 0}));
  RIPS_ASSIGN_OR_RETURN(const std::shared_ptr<const dds::Domain> domain,
                        dds::Domain::Create(command.domain));
  RIPS_ASSIGN_OR_RETURN(const auto participant, dds::Participant::Create(domain));
  Others others(participant->guid());
  RIPS_ASSIGN_OR_RETURN(
      const auto discovery,
      dds::Discovery::Create(*participant, {.on_endpoint = [&others](const auto& endpoint) {
        others.Seen(endpoint);
      }}));
  Servers servers(*participant, std::move(machine));
  RIPS_RETURN_IF_ERROR(servers.Serve());
  stop.WaitFor(kDiscoverTime);
  if (command.deafen) RIPS_RETURN_IF_ERROR(Deafen(others, command.domain.id));
  PrintEvent({{"event", "rival"},
              {"clients", others.Pairs().size()},
              {"unix_ns", RealClock().Now().unix_ns}});
  while (!stop.WaitFor(kRivalPeriod)) {
    servers.Advance();
    if (command.deafen_always) RIPS_RETURN_IF_ERROR(Deafen(others, command.domain.id));
  }
  return absl::OkStatus();
}

}  // namespace rips::robot_sim
