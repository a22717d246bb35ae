#include "sensor_agent/uplink/interest_exchange.h"

#include "services/runtime/log.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {

namespace {

// Answers that wait for the client's queue.
constexpr size_t kAnswersMax = 16;

}  // namespace

bool InterestExchange::Offered(const std::string& id) {
  if (id != handed_on_) return true;
  if (id == in_use_) Answer(id, "");
  return false;
}

void InterestExchange::InUse(const std::string& id) {
  in_use_ = id;
  Answer(id, "");
}

void InterestExchange::StreamBegan() {
  has_stream_ = true;
  answers_.clear();
}

void InterestExchange::StreamEnded() {
  has_stream_ = false;
  answers_.clear();
}

const rips::v1::InterestApplied* InterestExchange::Front() const {
  return answers_.empty() ? nullptr : &answers_.front();
}

void InterestExchange::Answer(const std::string& id, const std::string& problem) {
  if (!has_stream_) return;  // the next hello says it
  if (answers_.size() >= kAnswersMax) {
    LogDebug("interest reply dropped: the server does not read the stream");
    return;
  }
  rips::v1::InterestApplied& answer = answers_.emplace_back();
  answer.set_interest(id);
  answer.set_problem(problem);
  wire_limits::CutToLimits(answer);
}

}  // namespace rips::sensor
