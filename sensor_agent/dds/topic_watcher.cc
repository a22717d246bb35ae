#include "sensor_agent/dds/topic_watcher.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

TopicWatcher::TopicWatcher(const dds::Participant* participant, TopicWatcherOptions options,
                           std::function<void()> wake)
    : participant_(participant),
      options_(options),
      wake_(std::move(wake)),
      payloads_(options.payload_bytes),
      queue_({.capacity = options.queue}) {}

absl::Status TopicWatcher::Watch(const EndpointFact& writer) {
  if (key_of_.contains(writer.guid)) return absl::OkStatus();
  const ros2::DemangledTopic topic = ros2::DemangleTopic(writer.topic);
  if (!writer.writer || topic.kind != ros2::DdsTopicKind::kTopic) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", topic.name, "` has no writer of a ROS topic to read"));
  }
  Key key(writer.topic, writer.type, writer.qos.reliable && writer.qos.transient_local);
  if (!readers_.contains(key)) {
    if (absl::Status opened = Open(key); !opened.ok()) return opened;
  }
  readers_.find(key)->second->writers.insert(writer.guid);
  key_of_.emplace(writer.guid, std::move(key));
  return absl::OkStatus();
}

absl::Status TopicWatcher::Open(const Key& key) {
  if (readers_.size() >= options_.readers) {
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", options_.readers, " topics to read"));
  }
  const auto& [topic, type, latched] = key;
  auto reader = std::make_unique<Reader>();
  reader->key =
      std::make_shared<const ReaderKey>(ReaderKey{.topic = ros2::DemangleTopic(topic).name,
                                                  .type = ros2::DemangleType(type),
                                                  .latched = latched});
  *reader->wanted = Wanted(*reader->key);
  auto created = dds::RawReader::Create(
      *participant_,
      {.topic = topic,
       .type = type,
       .reliable_transient_local = latched,
       .payload_limit = reader->wanted},
      [this, raw = reader.get()](const dds::RawSample& sample) { OnSample(*raw, sample); });
  if (!created.ok()) return created.status();
  reader->reader = *std::move(created);
  readers_.emplace(key, std::move(reader));
  return absl::OkStatus();
}

uint32_t TopicWatcher::Wanted(const ReaderKey& key) const {
  return interest_ == nullptr ? 0 : interest_->PayloadBytes(key.topic, key.type);
}

void TopicWatcher::SetInterest(std::shared_ptr<const Interest> interest) {
  interest_ = std::move(interest);
  for (auto& [key, reader] : readers_) *reader->wanted = Wanted(*reader->key);
}

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
  if (!taken) ++reader.overflow;
  wake_();
}

void TopicWatcher::WriterGone(const ros2::Guid& writer) {
  const auto it = key_of_.find(writer);
  if (it == key_of_.end()) return;
  const auto reader = readers_.find(it->second);
  reader->second->writers.erase(writer);
  if (reader->second->writers.empty()) {
    reader->second->reader.reset();
    CountOverflow(*reader->second);
    readers_.erase(reader);
  }
  key_of_.erase(it);
}

std::vector<Sample> TopicWatcher::Take(size_t max) {
  return queue_.PopAll(absl::ZeroDuration(), max);
}

void TopicWatcher::CountOverflow(Reader& reader) {
  const uint64_t count = reader.overflow.exchange(0);
  if (count > 0) lost_[reader.key->topic] += count;
}

std::vector<Loss> TopicWatcher::TakeLosses(int64_t now_ns) {
  for (auto& [key, reader] : readers_) CountOverflow(*reader);
  std::vector<Loss> losses;
  for (const auto& [topic, count] : lost_) {
    losses.push_back({.cause = LossCause::kQueueFull,
                      .topic = topic,
                      .count = count,
                      .first_boottime_ns = now_ns,
                      .last_boottime_ns = now_ns});
  }
  lost_.clear();
  return losses;
}

}  // namespace rips::sensor
