!> A JSON Schema (draft 2020-12) of a namelist in the JSON form of f90nml, made from a list of keys.
!>
!> It has names, types and bounds of single keys; rules between keys are checked by the program
!> only, which also takes a text with more blanks at its end.
module battery_schema
  use battery_kinds, only: wp
  use battery_text, only: to_text, new_line_character
  use battery_key, only: key_type, allowed_text, choices_text, is_beyond, longest_text, &
    longest_range, whole_key, real_key, logical_key
  implicit none (type, external)
  private
  public :: schema_text

  character(len=*), parameter :: object = &
    '"type": "object", "additionalProperties": false, "properties": {'

  !> What f90nml adds to a group in which a key has an index, as in `number(1:2) = 10, 20`. It is no
  !> key, so it is not among the properties.
  character(len=*), parameter :: indices = &
    '"patternProperties": {"^_start_index$": {"type": "object"}}, '

contains

  !> Text of the schema: one line per key.
  pure function schema_text(keys) result(text)
    !> All keys, grouped, with a range after its list.
    type(key_type), intent(in) :: keys(:)
    character(len=:), allocatable :: text
    character(len=1), parameter :: nl = new_line_character
    character(len=:), allocatable :: bounds
    integer :: at

    text = '{"$schema": "https://json-schema.org/draft/2020-12/schema",'//nl//object
    bounds = ''
    do at = 1, size(keys)
      associate (key => keys(at))
        if (all(keys(:at - 1)%group /= key%group)) &
          text = text//nl//'  "'//trim(key%group)//'": {'//indices//object
        ! A range has the bounds of the list before it.
        if (.not. key%is_range) bounds = bounds_text(key)
        text = text//nl//'    "'//trim(key%name)//'": {"description": "'//description(key)//'", ' &
          //type_text(key, bounds)//'}'
        if (all(keys(at + 1:)%group /= key%group)) text = text//'}}'
        if (at < size(keys)) text = text//','
      end associate
    end do
    text = text//'}}'
  end function schema_text

  !> Text for the meaning of a key.
  pure function description(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    text = trim(key%meaning)//'; '//allowed_text(key)
    if (key%unit /= '') text = text//'; unit: '//trim(key%unit)
    if (key%symbol /= '') text = text//'; in the paper: '//trim(key%symbol)
    if (key%default /= '') text = text//'; default: '//trim(key%default)
  end function description

  !> Text for the type and the allowed values of a key.
  pure function type_text(key, bounds) result(text)
    type(key_type), intent(in) :: key
    !> Text for the bounds of the key's numbers.
    character(len=*), intent(in) :: bounds
    character(len=:), allocatable :: text, one

    select case (key%kind)
    case (whole_key, real_key)
      one = '"type": "'//trim(merge('integer', 'number ', key%kind == whole_key))//'"'//bounds
      if (key%is_range) then
        text = '"type": "array", "minItems": 3, "maxItems": 3, "prefixItems": [{'//one//'}, {' &
          //one//'}, {"type": "integer", "minimum": 1, "maximum": '//to_text(longest_range)//'}]'
      else
        text = either(one, key%most_values)
      end if
    case (logical_key)
      text = either('"type": "boolean"', 1)
    case default
      ! Excluded since they are invisible: control characters, and blanks before the text.
      text = '"type": "string", "maxLength": '//to_text(longest_text) &
        //', "not": {"pattern": "^ +[^ ]|[\\x00-\\x1f\\x7f]"}'
      if (key%default /= '''''') text = text//', "pattern": "[^ ]"'
      if (key%choices /= '') text = '"enum": ['//choices_text(trim(key%choices), '"')//']'
      text = either(text, 1)
    end select
  end function type_text

  !> Text for one value or a list, as f90nml gives also a single value with an index.
  pure function either(one, most) result(text)
    !> Text for the type of a value.
    character(len=*), intent(in) :: one
    !> Most values.
    integer, intent(in) :: most
    character(len=:), allocatable :: text

    text = '"anyOf": [{'//one//'}, {"type": "array", "minItems": 1, "maxItems": ' &
      //to_text(most)//', "items": {'//one//'}}]'
  end function either

  !> Text for the least and the greatest number of a key.
  pure function bounds_text(key) result(text)
    type(key_type), intent(in) :: key
    character(len=:), allocatable :: text

    text = ''
    if (key%least > -huge(1.0_wp)) text = text//', "' &
      //trim(merge('exclusiveMinimum', 'minimum         ', key%above))//'": '//to_text(key%least)
    if (is_beyond(key, huge(1.0_wp))) text = text//', "maximum": '//to_text(key%greatest)
  end function bounds_text

end module battery_schema
