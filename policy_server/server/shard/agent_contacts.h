// Which agents the inventory lists, which version each says it is, with which configuration it
// works, from which address it came, and when the server last heard from it. In memory only: a
// server that starts anew heard from none.
//
//   an agent                                       what it said heard
//   has not said hello since the server's start    empty        never
//   said hello, and the robot has admitted it      its own word when its last message came
//   was refused                                    stays        stays
//   its stream has ended                           stays        stays
//   is no longer listed                            removed      removed
//
// Contact grants nothing; version and configuration are only the agent's own word, and change
// together. Bounded by the inventory.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_CONTACTS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_CONTACTS_H_

#include <atomic>
#include <compare>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "rips/v1/session.pb.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

enum class AgentKind { kSensor, kActuator };

struct AgentId {
  std::string robot;
  AgentKind kind = AgentKind::kSensor;
  std::string host;

  friend auto operator<=>(const AgentId&, const AgentId&) = default;
};

// Any thread.
class AgentContacts {
 public:
  // Of a version; of a longer one the start is kept.
  static constexpr size_t kVersionBytesMax = 64;

  // When its last message came, by the server's CLOCK_BOOTTIME; 0 = never.
  using Heard = std::atomic<int64_t>;

  struct Contact {
    AgentId agent;
    // Untrusted text: escape before display. Empty = never heard.
    std::string version;
    // By the server's wall clock as it is now; 0 = never.
    int64_t heard_unix_ns = 0;
    int64_t heard_ago_ns = 0;
  };

  // `clock` is not owned and outlives this.
  explicit AgentContacts(const Clock* clock) : clock_(clock) {}

  // The agents that are listed from now on. What is known of those that stay is kept.
  void SetListed(std::vector<AgentId> agents) ABSL_LOCKS_EXCLUDED(mu_);
  // What an admitted agent said of itself.
  struct Greeting {
    std::string version;
    // IP address that it came from.
    std::string address;
    // A rips.v1.Configuration within its limits, serialized: as messages, strings of few bytes take
    // several times their size. Empty: it said none, it is of an older version.
    std::string configuration;
  };
  // The agent is admitted now. What its stream notes its messages in; null = it is not listed.
  std::shared_ptr<Heard> Greeted(const AgentId& agent, Greeting greeting) ABSL_LOCKS_EXCLUDED(mu_);
  // The listed agents of a robot, sensors first, by host.
  std::vector<Contact> Of(const std::string& robot) const ABSL_LOCKS_EXCLUDED(mu_);
  struct Said {
    AgentId agent;
    rips::v1::Configuration configuration;
    // By the server's wall clock as it was then.
    int64_t unix_ns = 0;
  };
  // What each of these said last, where it said one.
  std::vector<Said> ConfigurationsOf(const std::string& robot) const ABSL_LOCKS_EXCLUDED(mu_);
  // Listed agents that were admitted last from that address, at most `limit`: several behind one
  // NAT. Looks at all.
  std::vector<AgentId> At(absl::string_view address, size_t limit) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    Greeting said;
    int64_t said_unix_ns = 0;
    std::shared_ptr<Heard> heard = std::make_shared<Heard>(0);
  };

  const Clock* clock_;
  mutable Mutex mu_;
  absl::btree_map<AgentId, Entry> listed_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_CONTACTS_H_
