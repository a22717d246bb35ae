#include "policy_server/server/outputs/output_place.h"

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::outputs {

using operator_api::Cursor;
using operator_api::CursorPlace;

OutputPlace::OutputPlace(store::Store* store, const std::string& name)
    : store_(store), note_(absl::StrCat("output/", name)) {}

absl::Status OutputPlace::Find(const store::AlertRecord& newest) {
  if (cursor_.has_value()) return absl::OkStatus();
  const Cursor end{.sequence = newest.sequence, .id = newest.id};
  RIPS_ASSIGN_OR_RETURN(const std::string text, store_->Note(note_));
  if (text.empty()) {
    const std::string first = operator_api::FormatCursor(end);
    RIPS_RETURN_IF_ERROR(store_->SetNote(note_, first));
    noted_ = first;
    cursor_ = end;
    return absl::OkStatus();
  }
  const absl::StatusOr<Cursor> noted = operator_api::ParseCursor(text);
  CursorPlace place = CursorPlace::kUnknown;
  if (noted.ok()) {
    RIPS_ASSIGN_OR_RETURN(place, operator_api::FindCursor(*store_, *noted, newest));
  }
  lost_ = place == CursorPlace::kUnknown;
  if (lost_) {
    LogWarning(
        "the store does not know the alert that an output has delivered last; it goes on "
        "with the newest",
        {{"note", note_}, {"cursor", text}});
  }
  noted_ = text;
  cursor_ = lost_ ? end : *noted;
  return absl::OkStatus();
}

void OutputPlace::Advance(const store::AlertRecord& delivered) {
  cursor_ = Cursor{.sequence = delivered.sequence, .id = delivered.id};
}

void OutputPlace::Remember(int64_t now_ns, bool at_once) {
  if (!cursor_.has_value() || lost_ || (!at_once && now_ns - noted_ns_ < kNoteNs)) return;
  const std::string text = operator_api::FormatCursor(*cursor_);
  if (text == noted_) return;
  noted_ns_ = now_ns;
  if (store_->SetNote(note_, text).ok()) noted_ = text;
}

}  // namespace rips::outputs
