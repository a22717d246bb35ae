#include "sensor_agent/dds/topic_watcher.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/time/time.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

// Matches of one reader are looked at no more often than this, but for changes.
constexpr int64_t kLookIntervalNs = 250'000'000;

constexpr char kJumped[] = "sequence numbers jumped";

bool IsPattern(absl::string_view partition) {
  return partition.find_first_of("*?") != absl::string_view::npos;
}

// A partition in which a writer can be met that is in patterns only: patterns do not match
// patterns, but names. Empty if it is in a partition with a name, or in the default one.
std::string NameForPatterns(const std::vector<std::string>& partitions) {
  if (partitions.empty() || !std::all_of(partitions.begin(), partitions.end(), IsPattern)) {
    return {};
  }
  return absl::StrReplaceAll(partitions.front(), {{"*", ""}, {"?", "x"}});
}

}  // namespace

TopicWatcher::TopicWatcher(const dds::Participant* participant, TopicWatcherOptions options,
                           std::function<void()> wake)
    : participant_(participant),
      options_(options),
      wake_(std::move(wake)),
      payloads_(options.payload_bytes),
      queue_({.capacity = options.queue}),
      plan_(std::make_shared<WatchPlan>(WatchOptions{})) {}

// --- Endpoints

TopicWatcher::Key TopicWatcher::KeyOf(const EndpointFact& endpoint) {
  if (!endpoint.writer) return Key(endpoint.topic, endpoint.type, false, "");
  return Key(endpoint.topic, endpoint.type, endpoint.qos.reliable && endpoint.qos.transient_local,
             NameForPatterns(endpoint.qos.partitions));
}

absl::Status TopicWatcher::Watch(const EndpointFact& endpoint, int64_t now_ns) {
  const ros2::DemangledTopic topic = ros2::DemangleTopic(endpoint.topic);
  if (topic.kind != ros2::DdsTopicKind::kTopic) {
    return absl::InvalidArgumentError(absl::StrCat("`", topic.name, "` is no ROS topic to read"));
  }
  const Key key = KeyOf(endpoint);
  if (const auto known = members_.find(endpoint.guid); known != members_.end()) {
    if (known->second.key == key) return groups_.find(key)->second.problem;
    EndpointGone(endpoint.guid);
  }
  if (members_.size() >= options_.endpoints) {
    std::string why = absl::StrCat("more than ", options_.endpoints, " endpoints of topics");
    if (endpoint.writer) coverage_.push_back({.writer = endpoint.guid, .not_visible = why});
    return absl::ResourceExhaustedError(why);
  }
  Member& member = members_[endpoint.guid];
  member = {.key = key, .writer = endpoint.writer, .unreadable = endpoint.unreadable};
  Group& group = Join(key);
  group.members.insert(endpoint.guid);
  if (!group.wanted.messages) return absl::OkStatus();
  if (group.reader == nullptr && group.problem.ok()) {
    Open(key, group, /*resumed=*/false, now_ns);
  } else {
    Expect(key, group, member, now_ns);
  }
  return group.problem;
}

TopicWatcher::Group& TopicWatcher::Join(const Key& key) {
  const auto [it, added] = groups_.try_emplace(key);
  Group& group = it->second;
  if (added) {
    group.topic = ros2::DemangleTopic(std::get<0>(key)).name;
    group.type = ros2::DemangleType(std::get<1>(key));
    group.wanted = plan_->Of(group.topic, group.type);
  }
  return group;
}

void TopicWatcher::EndpointGone(const ros2::Guid& endpoint) {
  const auto it = members_.find(endpoint);
  if (it == members_.end()) return;
  const auto group = groups_.find(it->second.key);
  group->second.members.erase(endpoint);
  if (group->second.members.empty()) {
    Close(group->second);
    LookAgain(group->first, group->second, 0);
    groups_.erase(group);
  }
  members_.erase(it);
}

void TopicWatcher::SetJumped(const ros2::Guid& writer) {
  const auto it = members_.find(writer);
  if (it == members_.end()) return;
  it->second.jumped = true;
  it->second.visible = false;
  coverage_.push_back({.writer = writer, .not_visible = kJumped});
}

void TopicWatcher::SetPlan(std::shared_ptr<const WatchPlan> plan, int64_t now_ns) {
  plan_ = std::move(plan);
  // Those that close make room for those that open.
  for (auto& [key, group] : groups_) {
    group.wanted = plan_->Of(group.topic, group.type);
    if (group.reader != nullptr) *group.reader->wanted = group.wanted.payload_bytes;
    if (group.wanted.messages) continue;
    Close(group);
    LookAgain(key, group, 0);
    group.problem = absl::OkStatus();
    // Once it is needed again it is taken for visible until there is other news.
    for (const ros2::Guid& guid : group.members) members_.find(guid)->second.visible = true;
  }
  room_for_readers_ = false;
  for (auto& [key, group] : groups_) {
    if (group.wanted.messages && group.reader == nullptr) Open(key, group, true, now_ns);
  }
}

// --- Readers

void TopicWatcher::Open(const Key& key, Group& group, bool resumed, int64_t now_ns) {
  group.problem = Create(key, group, resumed);
  for (const ros2::Guid& guid : group.members) {
    Member& member = members_.find(guid)->second;
    Expect(key, group, member, now_ns);
    if (member.jumped) SetJumped(guid);
  }
}

absl::Status TopicWatcher::Create(const Key& key, Group& group, bool resumed) {
  if (readers_ >= options_.readers) {
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", options_.readers, " topics to read"));
  }
  const auto& [topic, type, latched, partition] = key;
  auto reader = std::make_unique<Reader>();
  reader->key = std::make_shared<const ReaderKey>(
      ReaderKey{.topic = group.topic, .type = group.type, .latched = latched, .resumed = resumed});
  *reader->wanted = group.wanted.payload_bytes;
  dds::RawReaderOptions options{
      .topic = topic,
      .type = type,
      .reliable_transient_local = latched,
      .payload_limit = reader->wanted,
      .every_partition = !options_.secured,
      .on_match = [this, raw = reader.get()] { matches_changed_ = raw->matches_changed = true; }};
  if (!partition.empty()) options.partitions.push_back(partition);
  auto created = dds::RawReader::Create(
      *participant_, options,
      [this, raw = reader.get()](const dds::RawSample& sample) { OnSample(*raw, sample); });
  if (!created.ok()) return created.status();
  reader->reader = *std::move(created);
  group.reader = std::move(reader);
  ++readers_;
  return absl::OkStatus();
}

void TopicWatcher::Close(Group& group) {
  if (group.reader == nullptr) return;
  group.reader->reader.reset();
  CountOverflow(*group.reader);
  group.reader.reset();
  --readers_;
  room_for_readers_ = true;
}

void TopicWatcher::Retry(int64_t now_ns) {
  if (!room_for_readers_) return;
  room_for_readers_ = false;
  for (auto& [key, group] : groups_) {
    if (absl::IsResourceExhausted(group.problem)) Open(key, group, /*resumed=*/true, now_ns);
  }
}

// --- What is visible

void TopicWatcher::Expect(const Key& key, Group& group, Member& member, int64_t now_ns) {
  if (!member.writer) return;
  member.match_by_ns = now_ns + options_.match_ns;
  // If there is no reader it is looked at at once, to say so.
  LookAgain(key, group, group.reader == nullptr ? now_ns : member.match_by_ns);
}

void TopicWatcher::LookAgain(const Key& key, Group& group, int64_t at_ns) {
  if (at_ns != 0 && group.look_ns != 0 && group.look_ns <= at_ns) return;
  if (group.look_ns != 0) looks_.erase({group.look_ns, key});
  group.look_ns = at_ns;
  if (at_ns != 0) looks_.emplace(at_ns, key);
}

void TopicWatcher::LookAt(const Key& key, Group& group, int64_t now_ns) {
  LookAgain(key, group, 0);
  absl::flat_hash_set<ros2::Guid> matched;
  if (group.reader != nullptr) {
    for (const ros2::Guid& guid : group.reader->reader->MatchedWriters()) matched.insert(guid);
  }
  int64_t next_ns = kNever;
  for (const ros2::Guid& guid : group.members) {
    Member& member = members_.find(guid)->second;
    if (!member.writer) continue;
    if (matched.contains(guid)) {
      member.match_by_ns = 0;
      Tell(guid, member, member.jumped ? kJumped : "");
      continue;
    }
    if (group.reader == nullptr) {
      member.match_by_ns = 0;
      Tell(guid, member, std::string(group.problem.message()));
      continue;
    }
    if (!member.visible) continue;
    // It may be going: the reader learns of that before we do.
    if (member.match_by_ns == 0) member.match_by_ns = now_ns + options_.match_ns;
    if (member.match_by_ns <= now_ns) {
      member.match_by_ns = 0;
      Tell(guid, member, WhyNotMatched(member));
    } else {
      next_ns = std::min(next_ns, member.match_by_ns);
    }
  }
  if (next_ns != kNever) LookAgain(key, group, std::max(next_ns, now_ns + kLookIntervalNs));
}

std::string TopicWatcher::WhyNotMatched(const Member& member) const {
  if (!member.unreadable.empty()) return member.unreadable;
  const std::string late = absl::StrCat("it has not matched our reader within ",
                                        absl::FormatDuration(absl::Nanoseconds(options_.match_ns)));
  return options_.secured ? absl::StrCat("DDS security: ", late) : late;
}

void TopicWatcher::Tell(const ros2::Guid& writer, Member& member, std::string not_visible) {
  const bool visible = not_visible.empty();
  if (visible == member.visible) return;
  member.visible = visible;
  coverage_.push_back({.writer = writer, .not_visible = std::move(not_visible)});
}

std::vector<Coverage> TopicWatcher::TakeCoverage(int64_t now_ns) {
  Retry(now_ns);
  if (matches_changed_.exchange(false)) {
    for (auto& [key, group] : groups_) {
      if (group.reader != nullptr && group.reader->matches_changed.exchange(false)) {
        LookAt(key, group, now_ns);
      }
    }
  }
  while (!looks_.empty() && looks_.begin()->first <= now_ns) {
    const auto group = groups_.find(looks_.begin()->second);
    LookAt(group->first, group->second, now_ns);
  }
  return std::exchange(coverage_, {});
}

int64_t TopicWatcher::NextDue() const { return looks_.empty() ? kNever : looks_.begin()->first; }

// --- Samples

void TopicWatcher::OnSample(Reader& reader, const dds::RawSample& sample) {
  // The middleware may have kept more: under an earlier limit, and always the header.
  const uint32_t wanted = *reader.wanted;
  Payload payload;
  if (wanted > 0) payload = payloads_.Keep(sample.payload.substr(0, wanted));
  const bool taken = queue_.Push({.writer = sample.writer,
                                  .reader = reader.key,
                                  .size_bytes = sample.size,
                                  .payload = std::move(payload),
                                  .sequence = sample.writer_sequence,
                                  .source_unix_ns = sample.source_unix_ns,
                                  .received_ns = sample.received.boottime_ns});
  if (!taken) {
    MutexLock lock(&reader.mu);
    const bool room = reader.overflow.size() < kOverflowWritersMax;
    ++reader
          .overflow[room || reader.overflow.contains(sample.writer) ? sample.writer : ros2::Guid{}];
    overflowed_ = true;
  }
  wake_();
}

bool TopicWatcher::Reads(const ros2::Guid& writer) const {
  const auto member = members_.find(writer);
  if (member == members_.end() || !member->second.visible) return false;
  const auto group = groups_.find(member->second.key);
  return group != groups_.end() && group->second.reader != nullptr;
}

std::vector<Sample> TopicWatcher::Take(size_t max) {
  return queue_.PopAll(absl::ZeroDuration(), max);
}

void TopicWatcher::CountOverflow(Reader& reader) {
  absl::flat_hash_map<ros2::Guid, uint64_t> overflow;
  {
    MutexLock lock(&reader.mu);
    overflow.swap(reader.overflow);
  }
  for (const auto& [writer, count] : overflow) {
    lost_.push_back({.topic = reader.key->topic, .writer = writer, .count = count});
  }
}

std::vector<QueueLoss> TopicWatcher::TakeLosses() {
  if (overflowed_.exchange(false)) {
    for (auto& [key, group] : groups_) {
      if (group.reader != nullptr) CountOverflow(*group.reader);
    }
  }
  return std::exchange(lost_, {});
}

}  // namespace rips::sensor
