#include "policy_server/server/shard/agent_contacts.h"

#include <algorithm>
#include <utility>

#include "services/base/cut_text.h"

namespace rips::pipeline {

void AgentContacts::SetListed(std::vector<AgentId> agents) {
  absl::btree_map<AgentId, Entry> listed;
  MutexLock lock(&mu_);
  for (AgentId& agent : agents) {
    const auto known = listed_.find(agent);
    Entry entry = known == listed_.end() ? Entry() : known->second;
    listed.emplace(std::move(agent), std::move(entry));
  }
  listed_ = std::move(listed);
}

std::shared_ptr<AgentContacts::Heard> AgentContacts::Greeted(const AgentId& agent,
                                                             Greeting greeting) {
  const Instant now = clock_->Now();
  MutexLock lock(&mu_);
  const auto found = listed_.find(agent);
  if (found == listed_.end()) return nullptr;
  greeting.version = Shortened(greeting.version, kVersionBytesMax);
  found->second.said = std::move(greeting);
  found->second.said_unix_ns = now.unix_ns;
  *found->second.heard = now.boottime_ns;
  return found->second.heard;
}

std::vector<AgentContacts::Contact> AgentContacts::Of(const std::string& robot) const {
  std::vector<Contact> contacts;
  const Instant now = clock_->Now();
  MutexLock lock(&mu_);
  for (auto it = listed_.lower_bound(AgentId{.robot = robot});
       it != listed_.end() && it->first.robot == robot; ++it) {
    Contact contact{.agent = it->first, .version = it->second.said.version};
    if (const int64_t heard_ns = *it->second.heard; heard_ns != 0) {
      // A message may have come since `now`.
      contact.heard_ago_ns = std::max<int64_t>(0, now.boottime_ns - heard_ns);
      contact.heard_unix_ns = now.unix_ns - contact.heard_ago_ns;
    }
    contacts.push_back(std::move(contact));
  }
  return contacts;
}

std::vector<AgentContacts::Said> AgentContacts::ConfigurationsOf(const std::string& robot) const {
  std::vector<Said> all;
  MutexLock lock(&mu_);
  for (auto it = listed_.lower_bound(AgentId{.robot = robot});
       it != listed_.end() && it->first.robot == robot; ++it) {
    const Entry& entry = it->second;
    Said said{.agent = it->first, .unix_ns = entry.said_unix_ns};
    const std::string& text = entry.said.configuration;
    if (text.empty() || !said.configuration.ParseFromString(text)) continue;
    all.push_back(std::move(said));
  }
  return all;
}

std::vector<AgentId> AgentContacts::At(absl::string_view address, size_t limit) const {
  std::vector<AgentId> agents;
  if (address.empty()) return agents;
  MutexLock lock(&mu_);
  for (const auto& [agent, entry] : listed_) {
    if (agents.size() == limit) break;
    if (entry.said.address == address) agents.push_back(agent);
  }
  return agents;
}

}  // namespace rips::pipeline
