#include "sensor_agent/messages/message_flow.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::sensor {

namespace {

using ros2::Endpoint;
using ros2::Guid;

bool Latched(const Endpoint& endpoint) {
  return endpoint.qos.reliable && endpoint.qos.transient_local;
}

}  // namespace

bool MessageFlow::MustWait(const Sample& sample, const Writer& writer) const {
  if (writer.revision == graph_->revision()) return false;
  const std::optional<Endpoint> known = graph_->Find(sample.writer);
  if (known.has_value()) return known->pending;
  // Not discovered yet, unless it was and has gone.
  return writer.source == nullptr;
}

void MessageFlow::Introduce(const Sample& sample, Writer& writer, bool& urgent) {
  if (writer.revision == graph_->revision()) return;
  std::optional<Endpoint> known = graph_->Find(sample.writer);
  writer.revision = known.has_value() && !known->pending ? graph_->revision() : 0;
  if (!known.has_value() && writer.source != nullptr) return;
  Endpoint endpoint = known.value_or(Endpoint{.guid = sample.writer,
                                              .kind = ros2::EndpointKind::kPublisher,
                                              .name = sample.reader->topic,
                                              .type = sample.reader->type,
                                              .visibility = ros2::Visibility::kWatched});
  endpoint.pending = false;
  if (writer.source != nullptr && writer.source->writer == endpoint) return;
  urgent = true;
  writer.source = std::make_shared<const MessageSource>(MessageSource{
      .topic = sample.reader->topic, .type = sample.reader->type, .writer = std::move(endpoint)});
}

uint64_t MessageFlow::GraphVersion(const Guid& guid, Writer& writer) const {
  if (writer.shown_revision == graph_->revision()) {
    writer.graph_version = graph_->version();
    return writer.graph_version;
  }
  const std::optional<uint64_t> showing = graph_->VersionShowing(guid);
  if (showing.has_value()) {
    writer.graph_version = *showing;
    writer.shown_revision = *showing <= graph_->version() ? graph_->revision() : 0;
  } else if (writer.graph_version == 0) {
    writer.graph_version = std::max<uint64_t>(graph_->version(), 1);
  }
  return writer.graph_version;
}

std::string MessageFlow::WhyImpossible(const Sample& sample, const Writer& writer) {
  const uint64_t number = sample.sequence;
  if (writer.newest == 0) {
    return number > kFirstNumberMax ? absl::StrCat("its first number is ", number) : "";
  }
  // A writer that keeps all it wrote may send it to a new reader from the start.
  const bool history = sample.reader->latched && sample.reader != writer.reader;
  if (number < writer.newest) {
    const uint64_t highest = writer.seen.highest();
    const bool back = !history && highest > number && highest - number > kNumbersSlack;
    return back ? absl::StrCat("its numbers went back from ", highest, " to ", number) : "";
  }
  const uint64_t rise_max = RiseMax(kNumbersPerSecond, sample.received_ns - writer.newest_ns);
  if (number - writer.newest <= rise_max) return "";
  return absl::StrCat("its numbers jumped from ", writer.newest, " to ", number);
}

void MessageFlow::Run(const Sample& sample, Writer& writer, Output& output) {
  MessageSeen message{.boottime_ns = sample.received_ns,
                      .writer_sequence = sample.sequence,
                      .source_unix_ns = sample.source_unix_ns,
                      .size_bytes = sample.size_bytes,
                      .payload = sample.payload};
  Introduce(sample, writer, message.urgent);
  const Endpoint& endpoint = writer.source->writer;
  const bool read_elsewhere = Latched(endpoint) && !sample.reader->latched &&
                              endpoint.visibility != ros2::Visibility::kNotVisible;
  const bool repeated = sample.sequence != 0 && writer.seen.Has(sample.sequence);
  if (read_elsewhere || repeated) {
    ++counters_.duplicates;
    return;
  }
  if (sample.sequence != 0) {
    if (std::string why = WhyImpossible(sample, writer); !why.empty()) {
      output.jumps.push_back({.writer = sample.writer, .detail = std::move(why)});
    }
    uint64_t missing = sample.sequence > writer.newest ? sample.sequence - writer.newest - 1 : 0;
    const uint64_t counted = std::min(missing, writer.queue_lost);
    writer.queue_lost -= counted;
    missing -= counted;
    const bool resumed = sample.reader->resumed && sample.reader != writer.reader;
    if (writer.newest != 0 && missing > 0 && !resumed) {
      output.losses.push_back({.cause = LossCause::kDdsGap,
                               .topic = sample.reader->topic,
                               .source = writer.source,
                               .count = missing,
                               .first_boottime_ns = sample.received_ns,
                               .last_boottime_ns = sample.received_ns});
    }
    writer.seen.Add(sample.sequence);
    writer.newest = sample.sequence;
    writer.newest_ns = sample.received_ns;
    writer.reader = sample.reader;
  }
  if (endpoint.node.empty()) ++counters_.unattributed;
  message.source = writer.source;
  message.graph_version = GraphVersion(sample.writer, writer);
  output.messages.push_back(std::move(message));
}

void MessageFlow::RunFront(Writer& writer, Output& output) {
  const Sample sample = std::move(writer.waiting.front().second);
  writer.waiting.pop_front();
  --waiting_;
  Run(sample, writer, output);
}

void MessageFlow::Take(Sample sample, int64_t now_ns, Output& output) {
  auto it = writers_.find(sample.writer);
  if (it == writers_.end() && (sample.writer.none() || writers_.size() >= options_.writers)) {
    Writer nobody;
    Run(sample, nobody, output);
    return;
  }
  if (it == writers_.end()) {
    it = writers_.emplace(sample.writer, std::make_unique<Writer>()).first;
    // Not discovered yet, or gone already: forgotten unless it is there by then.
    if (!graph_->Find(sample.writer).has_value()) End(sample.writer, *it->second, now_ns);
  }
  Writer& writer = *it->second;
  if (writer.waiting.empty() && !MustWait(sample, writer)) {
    Run(sample, writer, output);
    return;
  }
  const bool full =
      writer.waiting.size() >= options_.waiting_per_writer || waiting_ >= options_.waiting;
  if (full && writer.waiting.empty()) {
    Run(sample, writer, output);
    return;
  }
  if (full) RunFront(writer, output);
  ++waiting_;
  waiting_writers_.insert(sample.writer);
  writer.waiting.emplace_back(now_ns + options_.attribution_grace_ns, std::move(sample));
}

void MessageFlow::QueueLost(const Guid& writer, const std::string& topic, uint64_t count,
                            int64_t now_ns, Output& output) {
  const auto it = writers_.find(writer);
  if (it != writers_.end()) it->second->queue_lost += count;
  output.losses.push_back({.cause = LossCause::kQueueFull,
                           .topic = topic,
                           .source = it != writers_.end() ? it->second->source : nullptr,
                           .count = count,
                           .first_boottime_ns = now_ns,
                           .last_boottime_ns = now_ns});
}

void MessageFlow::Poll(int64_t now_ns, Output& output) {
  for (auto it = waiting_writers_.begin(); it != waiting_writers_.end();) {
    Writer& writer = *writers_.find(*it)->second;
    while (!writer.waiting.empty()) {
      const auto& [until_ns, sample] = writer.waiting.front();
      if (now_ns < until_ns && MustWait(sample, writer)) break;
      RunFront(writer, output);
    }
    it = writer.waiting.empty() ? waiting_writers_.erase(it) : std::next(it);
  }
  Bury(now_ns);
}

void MessageFlow::WriterGone(const Guid& guid, int64_t now_ns) {
  const std::optional<Endpoint> known = graph_->Find(guid);
  const bool wrote = known.has_value() && known->kind == ros2::EndpointKind::kPublisher &&
                     known->visibility == ros2::Visibility::kWatched;
  auto it = writers_.find(guid);
  if (it == writers_.end()) {
    // Its first sample may be in a queue. Those that never wrote leave room for those that did.
    if (!wrote || writers_.size() >= options_.writers / 2) return;
    it = writers_.emplace(guid, std::make_unique<Writer>()).first;
  }
  Writer& writer = *it->second;
  // If it comes back its numbers may begin again, and mean other samples: better twice than never.
  writer.seen = {};
  if (writer.source == nullptr && wrote && !known->pending) {
    writer.graph_version = graph_->VersionShowing(guid).value_or(0);
    writer.source = std::make_shared<const MessageSource>(
        MessageSource{.topic = known->name, .type = known->type, .writer = *known});
  }
  End(guid, writer, now_ns);
}

void MessageFlow::End(const Guid& guid, Writer& writer, int64_t now_ns) {
  writer.gone_ns = now_ns;
  graves_.emplace_back(now_ns, guid);
}

void MessageFlow::Bury(int64_t now_ns) {
  while (!graves_.empty() && graves_.front().first + options_.tombstone_ns <= now_ns) {
    const auto [gone_ns, guid] = graves_.front();
    graves_.pop_front();
    const auto it = writers_.find(guid);
    if (it == writers_.end() || it->second->gone_ns != gone_ns) continue;
    if (graph_->Find(guid).has_value()) {  // it has come back
      it->second->gone_ns = 0;
      continue;
    }
    waiting_ -= it->second->waiting.size();
    waiting_writers_.erase(guid);
    writers_.erase(it);
  }
}

uint64_t MessageFlow::HighestSequence(const ros2::Guid& writer) const {
  const auto it = writers_.find(writer);
  return it == writers_.end() ? 0 : it->second->seen.highest();
}

int64_t MessageFlow::NextDue() const {
  int64_t due = kNever;
  for (const Guid& guid : waiting_writers_) {
    due = std::min(due, writers_.find(guid)->second->waiting.front().first);
  }
  return due;
}

}  // namespace rips::sensor
